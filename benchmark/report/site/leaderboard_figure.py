"""The leaderboard as one self-contained picture: success of each solver on each task, with its interval."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark.report.formatting import percent
from benchmark.report.site.panels import colour_of
from benchmark.report.site.revisions import PageMark, not_of_today
from benchmark.report.site.site_view import MatrixRow, SiteView
from benchmark.report.site.task_groups import OTHERS, group_of
from benchmark.report.site.tree import TaskFacts
from generator.drawing.palette import INK, SOFT
from generator.drawing.style import DPI, axes_at, house_style, new_figure
from generator.drawing.svg import standalone_svg

_LEAST_WIDTH_PX = 660
_NAME_PX, _CELL_PX, _GAP_PX, _ROW_PX, _HEAD_PX, _FOOT_PX, _EDGE_PX = 168, 96, 24, 24, 96, 48, 18
_TITLE_PX, _AXIS_PX = 34, 30
_LINE_LETTERS = 18
_MOST_COLUMNS = 7
_TICKS = ((0.0, "0"), (0.5, ""), (1.0, "100 %"))


@dataclass(frozen=True)
class _Band:
    """Part of the picture: some groups of tasks, side by side, with all solvers that ran them; `title` is at its top."""

    title: str
    places: tuple[int, ...]
    rows: tuple[MatrixRow, ...]

    @property
    def height_px(self) -> int:
        return (_TITLE_PX if self.title else 0) + _HEAD_PX + _ROW_PX * len(self.rows) + _AXIS_PX


@house_style()
def leaderboard_svg(view: SiteView, mark: PageMark) -> str:
    """Draw the successes, one block per question; the picture follows the reader's light or dark theme.

    Parameters
    ----------
    view : SiteView
    mark : PageMark
        Mark of the results that are drawn.
    """
    matrix = next(matrix for matrix in view.matrices if matrix.key == "success")
    rows_of = {one.key: [row for row in matrix.rows if row.detections == one.key] for one in view.overall}
    bands = [band for one in view.overall for band in _bands(one.title, view.tasks, rows_of[one.key])]
    most = max(len(band.places) for band in bands)
    width = max(_EDGE_PX * 2 + _NAME_PX + most * (_CELL_PX + _GAP_PX), _LEAST_WIDTH_PX)
    height = _EDGE_PX + sum(band.height_px for band in bands) + _FOOT_PX
    figure = new_figure(width, height)
    top = float(_EDGE_PX)
    for band in bands:
        _draw_band(figure, band, view.tasks, top)
        top += band.height_px
    limits = {task.limit_km for task in view.tasks}
    within = f"{limits.pop():g} km" if len(limits) == 1 else "each task's limit"
    note = f"Share of frames solved to within {within}, with 95 % intervals."
    _words(figure, _EDGE_PX, height - 36, note, soft=True)
    _words(figure, _EDGE_PX, height - 18, f"{mark.sentence} ° not of today's code.", soft=True)
    n_solvers = len({row.label for band in bands for row in band.rows})
    drawing = standalone_svg(figure, f"Success of {n_solvers} solvers on {len(view.tasks)} tasks", note)
    return drawing.replace("</svg>", f"{mark.line}\n<desc>{escape(mark.sentence)}</desc>\n</svg>")


def _bands(title: str, tasks: Sequence[TaskFacts], rows: Sequence[MatrixRow]) -> list[_Band]:
    """Arrange groups of tasks that these solvers ran, as many side by side as there is room for."""
    ran = [place for place in range(len(tasks)) if any(row.cells[place][1] is not None for row in rows)]
    packed: list[list[int]] = []
    for _, group in itertools.groupby(ran, key=lambda place: group_of(tasks[place].name)):
        every = list(group)
        for start in range(0, len(every), _MOST_COLUMNS):
            part = every[start : start + _MOST_COLUMNS]
            if packed and len(packed[-1]) + len(part) <= _MOST_COLUMNS:
                packed[-1].extend(part)
            else:
                packed.append(list(part))
    bands = []
    for n, places in enumerate(packed):
        mine = [row for row in rows if any(row.cells[place][1] is not None for place in places)]
        bands.append(_Band("" if n else title, tuple(places), tuple(mine)))
    return bands


def _draw_band(figure: Figure, band: _Band, tasks: Sequence[TaskFacts], top: float) -> None:
    if band.title:
        _words(figure, _EDGE_PX, top + 0.4 * _TITLE_PX, band.title, bold=True)
        top += _TITLE_PX
    lefts = [_EDGE_PX + _NAME_PX + n * (_CELL_PX + _GAP_PX) for n in range(len(band.places))]
    before = ""
    for left, place in zip(lefts, band.places, strict=True):
        task = tasks[place]
        group = group_of(task.name)
        if group not in (before, OTHERS):
            _words(figure, left, top + 8, group, soft=True)
        before = group
        _words(figure, left, top + 30, task.name, bold=True)
        lines = textwrap.wrap(task.condition, _LINE_LETTERS, max_lines=3, placeholder="…")
        for number, line in enumerate(lines):
            _words(figure, left, top + 47 + 15 * number, line, soft=True)
    _draw_block(figure, band, lefts, top + _HEAD_PX)


def _draw_block(figure: Figure, band: _Band, lefts: Sequence[float], top: float) -> None:
    """Draw the solvers' names and their successes on each task, from `top` px downwards."""
    for n, row in enumerate(band.rows):
        middle = top + _ROW_PX * (n + 0.5)
        _words(figure, _EDGE_PX, middle, _short(row.label), bold=True)
        if not_of_today(entry for _, entry in (row.cells[place] for place in band.places) if entry is not None):
            _words(figure, _EDGE_PX + _NAME_PX - 14, middle, "°", soft=True)
    for column, left in zip(band.places, lefts, strict=True):
        _draw_task(axes_at(figure, left, top, _CELL_PX, _ROW_PX * len(band.rows)), band.rows, column)


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
        # Wider than the dot, so that a narrow interval is visible next to it.
        axes.hlines([place], [success.low], [success.high], colors=[colour], linewidth=12.0, alpha=0.4)
        (dot,) = axes.plot([success.value], [place], "o", markersize=5.0, color=colour, clip_on=False)
        dot.set_gid(f"{row.label}: {percent(success.value)}")


def _words(figure: Figure, u: float, v: float, words: str, bold: bool = False, soft: bool = False) -> None:
    """Write words to the right of a position, px from the top left corner."""
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
