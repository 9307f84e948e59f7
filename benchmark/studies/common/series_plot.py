"""Figures of a study: series differ in colour, shape, filling and dashes, so that a monochrome print separates them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from typing import Any

from matplotlib.axes import Axes
from matplotlib.transforms import ScaledTranslation

from benchmark.report.site.panels import DOTTED, MARKERS
from generator.drawing.palette import INK, PAPER, SERIES
from generator.drawing.style import DPI, axes_at, house_style, new_figure
from generator.drawing.svg import inline_svg, svg_marks

WIDTH, HEIGHT = 360, 230
"""Size of a figure and of its drawing area, px."""
LEFT, RIGHT, BOTTOM = 46, 12, 44
_UNIT_PX, _LINE_PX = 26, 15
_SAMPLE_PX = (30, 12)
_LINES = {"solid": "-", "dashed": (0.0, (7.0, 4.0)), "dotted": DOTTED}


@dataclass(frozen=True)
class Series:
    """Points, in the units of the axes.

    Attributes
    ----------
    name : str
        Name in the legend; a series without a name does not appear in it.
    x, y : sequence of float
        Infinite or undefined points are left out.
    low, high : sequence of float or None
        Intervals in y.
    shape : str
        ``circle``, ``square``, ``triangle``, ``diamond``, ``dot`` (small, for many) or ``none``.
    filled : bool
    line : str
        ``solid``, ``dashed``, ``dotted`` or ``none``.
    shift_px : float
        Sideways shift, so that intervals of several series are side by side.
    colour : int or None
        Index in the palette of series; None for ink.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    shape: str = "circle"
    filled: bool = True
    line: str = "solid"
    shift_px: float = 0.0
    colour: int | None = None


@dataclass(frozen=True)
class Axis:
    """An axis: title, ends, ticks and their labels; `log` for a logarithmic one."""

    title: str
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]
    log: bool = False

    def clamped(self, value: float) -> float:
        """Move a value beyond the axis to the nearer end."""
        return min(max(value, min(self.low, self.high)), max(self.low, self.high))


@house_style()
def plot(series: Sequence[Series], x: Axis, y: Axis, label: str) -> str:
    """Draw series.

    Parameters
    ----------
    series : sequence of Series
    x, y : Axis
        `x.low` may exceed `x.high`: the axis then runs the other way. Points and intervals beyond `y` are drawn at its end.
    label : str
        Description for screen readers.

    Returns
    -------
    str
        The legend as a list, and an SVG element, in the colours of the page. The page wraps the legend to its width.
    """
    extra_lines = max(words.count("\n") for _, words in x.ticks)
    figure = new_figure(WIDTH, _UNIT_PX + HEIGHT + BOTTOM + _LINE_PX * extra_lines)
    axes = axes_at(figure, LEFT, _UNIT_PX, WIDTH - LEFT - RIGHT, HEIGHT)
    axes.set(
        xscale="log" if x.log else "linear",
        yscale="log" if y.log else "linear",
        xlim=(x.low, x.high),
        ylim=(y.low, y.high),
        autoscale_on=False,
    )
    axes.set_xticks([value for value, _ in x.ticks], [words for _, words in x.ticks])
    axes.set_yticks([value for value, _ in y.ticks], [words for _, words in y.ticks])
    axes.minorticks_off()
    axes.set_xlabel(x.title, x=0.5 - (LEFT - RIGHT) / 2.0 / (WIDTH - LEFT - RIGHT))
    axes.annotate(y.title, (0.0, 1.0), (4.0 - LEFT, 10.0), "axes fraction", "offset points")
    for one in series:
        _draw(axes, one, y)
    return _legend(one for one in series if one.name) + inline_svg(figure, label)


def _draw(axes: Axes, one: Series, y: Axis) -> None:
    aside = ScaledTranslation(one.shift_px / DPI, 0.0, axes.figure.dpi_scale_trans)
    colour = INK.light if one.colour is None else SERIES[one.colour].light
    drawn = [
        (n, place, y.clamped(value))
        for n, (place, value) in enumerate(zip(one.x, one.y, strict=True))
        if math.isfinite(place) and math.isfinite(value)
    ]
    if one.low is not None and one.high is not None and drawn:
        lows, highs = ([y.clamped(ends[n]) for n, _, _ in drawn] for ends in (one.low, one.high))
        places = [place for _, place, _ in drawn]
        axes.vlines(places, lows, highs, colors=[colour], linewidth=1.3, transform=axes.transData + aside)
    places, values = [place for _, place, _ in drawn], [value for _, _, value in drawn]
    axes.plot(places, values, transform=axes.transData + aside, **_look(one))


def _legend(named: Iterable[Series]) -> str:
    """List of names with samples of their lines and marks; empty without names."""
    items = [f"<li>{_sample(one.shape, one.filled, one.line, one.colour)}{escape(one.name)}</li>" for one in named]
    return f'<ul class="legend">{"".join(items)}</ul>' if items else ""


@cache
def _sample(shape: str, filled: bool, line: str, colour: int | None) -> str:
    """Draw a short piece of a series' line with one mark."""
    across, down = _SAMPLE_PX
    figure = new_figure(across, down)
    axes = axes_at(figure, 0, 0, across, down)
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), autoscale_on=False)
    axes.set_axis_off()
    look = _look(Series("", (), (), shape=shape, filled=filled, line=line, colour=colour))
    axes.plot([0.0, 0.5, 1.0], [0.5, 0.5, 0.5], markevery=[1], **look)
    return f'<svg viewBox="0 0 {across} {down}" fill="none" aria-hidden="true">{svg_marks(figure)}</svg>'


def _look(one: Series) -> dict[str, Any]:
    """Matplotlib's arguments for a series' line and marks."""
    colour = INK.light if one.colour is None else SERIES[one.colour].light
    marker, size = ("o", 3.6) if one.shape == "dot" else MARKERS.get(one.shape, ("", 0.0))
    return {
        "linestyle": _LINES.get(one.line, ""),
        "linewidth": 1.5,
        "marker": marker,
        "markersize": size,
        "color": colour,
        "markerfacecolor": colour if one.filled else PAPER.light,
        "markeredgewidth": 0.8 if one.shape == "dot" else 1.4,
        "clip_on": False,
    }
