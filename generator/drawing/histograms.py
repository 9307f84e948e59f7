"""Distributions side by side, as a standalone picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from generator.drawing.palette import SERIES
from generator.drawing.style import axes_at, house_style, new_figure
from generator.drawing.svg import standalone_svg

COLUMNS = 2
WIDTH_PX, HEIGHT_PX = 230, 120
"""Size of one distribution's drawing area."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 22, 28, 44
_FEWEST_BINS, _MOST_BINS, _TICKS = 5, 30, 5


@house_style()
def draw_histograms(distributions: Sequence[tuple[str, NDArray[np.float64]]], counted: str) -> str:
    """Draw the distribution of each quantity.

    Parameters
    ----------
    distributions : sequence of (str, (n,) array)
        Title with its unit, and finite values that differ; if there are none, the picture says so.
    counted : str
        Name of the things that the bars count.

    Returns
    -------
    str
        The picture as SVG.
    """
    across, down = _LEFT + WIDTH_PX + _RIGHT, _TOP + HEIGHT_PX + _BOTTOM
    rows = -(-len(distributions) // COLUMNS)
    figure = new_figure(across * min(COLUMNS, max(len(distributions), 1)), down * rows if rows else 40)
    if not distributions:
        words = f"All {counted} have the same conditions."
        figure.text(0.5, 0.5, words, ha="center", va="center_baseline")
        return standalone_svg(figure, words)
    for place, (title, values) in enumerate(distributions):
        row, column = divmod(place, COLUMNS)
        axes = axes_at(figure, column * across + _LEFT, row * down + _TOP, WIDTH_PX, HEIGHT_PX)
        bins = min(_MOST_BINS, max(_FEWEST_BINS, len(np.unique(values))))
        counts, edges = np.histogram(values, bins)
        axes.stairs(counts, edges, fill=True, color=SERIES[0].light, linewidth=0.0)
        axes.set(xlim=(edges[0], edges[-1]), ylim=(0.0, 1.05 * counts.max()), xlabel=title)
        axes.locator_params(axis="x", nbins=_TICKS)
        axes.locator_params(axis="y", nbins=4, integer=True)
        axes.annotate(counted, (0.0, 1.0), (4.0 - _LEFT, 10.0), "axes fraction", "offset points")
    titles = ", ".join(title for title, _ in distributions)
    return standalone_svg(figure, f"Distributions over all {counted}", titles)
