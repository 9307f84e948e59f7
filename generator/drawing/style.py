"""The house style of figures. One unit of length is one pixel of the page: 72 dots per inch, sizes in points."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from generator.drawing.palette import INK, LINE, PAPER, SERIES, SOFT

DPI = 72
FONT_PX = 12.0
LIGHT_PX = 1.0
"""Line width of axes, grids and limits."""
HOUSE = {
    "axes.axisbelow": True,
    "axes.edgecolor": SOFT.light,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.labelcolor": INK.light,
    "axes.labelsize": FONT_PX,
    "axes.linewidth": LIGHT_PX,
    "axes.prop_cycle": cycler(color=[one.light for one in SERIES]),
    "axes.spines.left": False,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": FONT_PX,
    "figure.dpi": DPI,
    "figure.facecolor": PAPER.light,
    "font.family": "DejaVu Sans",
    "font.size": FONT_PX,
    "grid.color": LINE.light,
    "grid.linewidth": LIGHT_PX,
    "legend.frameon": False,
    "lines.linewidth": 2.0,
    "lines.markersize": 7.0,
    "lines.scale_dashes": False,
    "path.simplify": False,
    "savefig.facecolor": PAPER.light,
    "text.color": INK.light,
    "text.parse_math": False,  # a name with dollar signs is a name
    "xtick.color": SOFT.light,
    "xtick.labelsize": FONT_PX,
    "xtick.major.size": 4.0,
    "xtick.major.width": LIGHT_PX,
    "ytick.color": SOFT.light,
    "ytick.labelsize": FONT_PX,
    "ytick.left": False,
    "ytick.minor.left": False,
}
_LOCK = threading.RLock()


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the house style, regardless of the user's matplotlibrc; one thread at a time.

    Matplotlib's settings are shared by all threads, so threads that draw wait for each other.
    """
    keep = {"backend", "backend_fallback", "interactive", "toolbar", "timezone"}
    defaults: dict[str, Any] = {name: value for name, value in mpl.rcParamsDefault.items() if name not in keep}
    with _LOCK, mpl.rc_context({**defaults, **HOUSE}):
        yield


def new_figure(width_px: float, height_px: float, background: bool = False) -> Figure:
    """Return an empty figure, transparent unless it needs a background; it is not registered with pyplot."""
    return Figure(figsize=(width_px / DPI, height_px / DPI), dpi=DPI, frameon=background)


def axes_at(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Add axes of a given size at a place in the figure, px from its top left corner."""
    across, down = figure.get_size_inches() * DPI
    return figure.add_axes((left / across, 1.0 - (top + height) / down, width / across, height / down))
