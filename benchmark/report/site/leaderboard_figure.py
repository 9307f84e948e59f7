"""The leaderboard as one picture that stands by itself: success of each solver on each task, with its interval."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from markupsafe import escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark.report.formatting import percent
from benchmark.report.site.panels import colour_of
from benchmark.report.site.revisions import PageMark, not_of_today
from benchmark.report.site.site_view import MatrixRow, SiteView
from generator.drawing.palette import INK, SOFT
from generator.drawing.style import DPI, axes_at, house_style, new_figure
from generator.drawing.svg import standalone_svg

_LEAST_WIDTH_PX = 660
_NAME_PX, _CELL_PX, _GAP_PX, _ROW_PX, _HEAD_PX, _FOOT_PX, _EDGE_PX = 168, 96, 24, 30, 90, 48, 18
_TITLE_PX, _AXIS_PX = 34, 30
_LINE_LETTERS = 18
_TICKS = ((0.0, "0"), (0.5, ""), (1.0, "100 %"))


@house_style()
def leaderboard_svg(view: SiteView, mark: PageMark) -> str:
    """Draw the successes, one block to each question; the picture follows the reader from light to dark.

    Parameters
    ----------
    view : SiteView
    mark : PageMark
        Of the results that are drawn.
    """
    matrix = next(matrix for matrix in view.matrices if matrix.key == "success")
    blocks = [(one.title, [row for row in matrix.rows if row.detections == one.key]) for one in view.overall]
    width = max(_EDGE_PX * 2 + _NAME_PX + len(view.tasks) * (_CELL_PX + _GAP_PX), _LEAST_WIDTH_PX)
    height = _HEAD_PX + sum(_TITLE_PX + _ROW_PX * len(rows) + _AXIS_PX for _, rows in blocks) + _FOOT_PX
    figure = new_figure(width, height)
    lefts = [_EDGE_PX + _NAME_PX + column * (_CELL_PX + _GAP_PX) for column in range(len(view.tasks))]
    for left, task in zip(lefts, view.tasks, strict=True):
        _words(figure, left, 24, task.name, bold=True)
        lines = textwrap.wrap(task.condition, _LINE_LETTERS, max_lines=3, placeholder="…")
        for number, line in enumerate(lines):
            _words(figure, left, 41 + 15 * number, line, soft=True)
    top = _HEAD_PX
    for title, rows in blocks:
        _words(figure, _EDGE_PX, top + 0.5 * _TITLE_PX, title, bold=True)
        top += _TITLE_PX
        _draw_block(figure, rows, lefts, top)
        top += _ROW_PX * len(rows) + _AXIS_PX
    note = "Share of frames solved to within 10 km, with 95 % intervals."
    _words(figure, _EDGE_PX, height - 36, note, soft=True)
    _words(figure, _EDGE_PX, height - 18, f"{mark.sentence} ° not of today's code.", soft=True)
    n_solvers = len({row.label for _, rows in blocks for row in rows})
    drawing = standalone_svg(figure, f"Success of {n_solvers} solvers on {len(view.tasks)} tasks", note)
    return drawing.replace("</svg>", f"{mark.line}\n<desc>{escape(mark.sentence)}</desc>\n</svg>")


def _draw_block(figure: Figure, rows: Sequence[MatrixRow], lefts: Sequence[float], top: float) -> None:
    """The solvers' names and their successes on each task, from a height of `top` px down."""
    for n, row in enumerate(rows):
        middle = top + _ROW_PX * (n + 0.5)
        _words(figure, _EDGE_PX, middle, _short(row.label), bold=True)
        if not_of_today(entry for _, entry in row.cells if entry is not None):
            _words(figure, _EDGE_PX + _NAME_PX - 14, middle, "°", soft=True)
    for column, left in enumerate(lefts):
        _draw_task(axes_at(figure, left, top, _CELL_PX, _ROW_PX * len(rows)), rows, column)


def _draw_task(axes: Axes, rows: Sequence[MatrixRow], column: int) -> None:
    axes.set(xlim=(0.0, 1.0), ylim=(len(rows) - 0.5, -0.5), yticks=[], autoscale_on=False)
    axes.set_xticks([value for value, _ in _TICKS], [words for _, words in _TICKS])
    axes.tick_params(axis="x", length=0.0, pad=5.0)
    axes.grid(axis="x")
    axes.spines["bottom"].set_visible(False)
    first, _, last = axes.get_xticklabels()
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")
    for place, row in enumerate(rows):
        entry = row.cells[column][1]
        if entry is None:
            axes.text(0.5, place, "not run", ha="center", va="center_baseline", color=SOFT.light)
            continue
        success, colour = entry.success, colour_of(row.style.colour)
        if math.isnan(success.value):
            continue
        # Wider than the dot, so that a narrow interval shows beside it.
        axes.hlines([place], [success.low], [success.high], colors=[colour], linewidth=12.0, alpha=0.4)
        (dot,) = axes.plot([success.value], [place], "o", markersize=5.0, color=colour, clip_on=False)
        dot.set_gid(f"{row.label}: {percent(success.value)}")


def _words(figure: Figure, u: float, v: float, words: str, bold: bool = False, soft: bool = False) -> None:
    """Words from a place to the right, px from the top left corner."""
    across, down = figure.get_size_inches() * DPI
    figure.text(
        u / across,
        1.0 - v / down,
        words,
        va="center_baseline",
        fontweight="bold" if bold else "normal",
        color=(SOFT if soft else INK).light,
    )


def _short(words: str, most: int = 26) -> str:
    return words if len(words) <= most else f"{words[: most - 1]}…"
