"""Writing the site: one page to the leaderboard, one to each board, one to each solver, each complete in itself."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from rich.markup import escape
from rich.table import Table

from benchmark.report.formatting import interval, number, percent
from benchmark.report.site import charts, columns
from benchmark.report.site.boards import Board, Entry, make_board
from benchmark.report.site.charts import Mark, Style
from benchmark.report.site.failures import Card, make_cards
from benchmark.report.site.frame_source import FrameSource
from benchmark.report.site.leaderboard_figure import leaderboard_svg
from benchmark.report.site.site_view import (
    board_provenance,
    board_verdict,
    detectable_words,
    make_styles,
    make_view,
    solver_page,
)
from benchmark.report.site.tree import read_tree
from benchmark.report.templates import environment, read_sheet
from benchmark.run.results import write_atomically
from benchmark.stats.confidence import RiskCoverage
from benchmark.stats.intervals import Estimate
from generator.drawing.palette import palette_sheet

SITE_FOLDER = "site"
LARGEST_SITE_BYTES = 4_900_000
_SHEETS = ("page.css", "figure.css", "site/site.css")


def make_boards(root: Path, progress: Callable[[int, int], None] = lambda done, of: None) -> list[Board]:
    """Compare all results of a tree, board by board.

    Parameters
    ----------
    root : Path
        Tree of results.
    progress : callable
        Called with the boards done and their number.

    Raises
    ------
    ResultsError
        There are no results, damaged ones, or some that cannot be compared.
    """
    groups = read_tree(root)
    boards = []
    for done, group in enumerate(groups):
        progress(done, len(groups))
        boards.append(make_board(group))
    progress(len(groups), len(groups))
    return boards


def write_site(boards: Sequence[Board], root: Path, data: Path | None = None) -> Path:
    """Write the report to ``root/site``; pages that an earlier report left there go.

    Parameters
    ----------
    boards : sequence of Board
    root : Path
        Tree of results.
    data : Path, optional
        Folder of the tasks' rendered frames, for pictures; see `FrameSource`.

    Returns
    -------
    Path
        Of the first page.

    Raises
    ------
    ResultsError
        A picture is damaged.
    """
    folder = root / SITE_FOLDER
    pages = render_site(boards, FrameSource(data), root.name or ".")
    for name, page in pages.items():
        write_atomically(folder / name, page.encode())
    for old in folder.glob("*.html"):
        if old.name not in pages:
            old.unlink()
    return folder / "index.html"


def result_table(boards: Sequence[Board]) -> Table:
    """What the terminal shows: all numbers of one board, or the successes of several."""
    return board_table(boards[0]) if len(boards) == 1 else leaderboard_table(boards)


def board_table(board: Board) -> Table:
    """All numbers of one board with their intervals, for the terminal."""
    title = f"{board.task.title} ({board.title}): {board.n_frames} frames (95 % intervals in brackets)"
    table = Table(title=escape(title), title_justify="left")
    table.add_column("", no_wrap=True)
    for entry in board.entries:
        table.add_column(escape(entry.label), justify="left", overflow="fold")
    for column in columns.HEADLINE:
        shown = [(column.value(entry), column.interval(entry)) for entry in board.entries]
        table.add_row(column.heading, *(f"{value} [dim]\\[{limits}][/dim]" for value, limits in shown))
    counts = [", ".join(str(count) for count in entry.statuses.values()) for entry in board.entries]
    table.add_row("fixes, refused, errors", *counts)
    return table


def leaderboard_table(boards: Sequence[Board]) -> Table:
    """Success of each solver on each task with its interval, for the terminal."""
    view = make_view(boards, make_styles(boards), ".")
    matrix = next(matrix for matrix in view.matrices if matrix.column is columns.SUCCESS)
    title = "Percentage of frames within 10 km of the truth, and its 95 % interval"
    table = Table(title=title, title_justify="left", padding=(0, 0, 0, 1))
    table.add_column("solver", overflow="fold")
    table.add_column("by")
    for task in view.tasks:
        table.add_column(task.key, overflow="fold", justify="right", min_width=6)
    for row in matrix.rows:
        cells = ["not run" if entry is None else _in_percent(entry.success) for _, entry in row.cells]
        table.add_row(escape(row.label), row.detections, *cells)
    return table


def _in_percent(share: Estimate) -> str:
    low, value, high = (f"{100 * number:.0f}" for number in (share.low, share.value, share.high))
    return f"{value}\n[dim]{low}–{high}[/dim]"


def render_site(boards: Sequence[Board], source: FrameSource, out_name: str) -> dict[str, str]:
    """All pages, by file name."""
    styles = make_styles(boards)
    view = make_view(boards, styles, out_name)
    template = _templates(styles)
    drawn = [_board_charts(board, styles) for board in boards]

    def board_page(place: int, cards: Sequence[Card]) -> str:
        board = boards[place]
        return template("board.html").render(
            board=board,
            siblings=[one for one in boards if one.task.key == board.task.key and one is not board],
            verdict=board_verdict(board),
            detectable_words=detectable_words(board),
            charts=drawn[place],
            differences=_differences(board),
            cards=cards,
            provenance=board_provenance(board),
        )

    curves = {
        solver.name: [
            (board, _success_panel(board, entry, styles[solver.name]))
            for board, entry in solver.entries
            if board.task.by
        ]
        for solver in view.solvers
    }

    def solver_pages(anchors: Mapping[tuple[str, str], str]) -> dict[str, str]:
        return {
            solver.file_name: template("solver.html").render(solver=solver, curves=curves[solver.name], anchors=anchors)
            for solver in view.solvers
        }

    index = template("index.html").render(site=view)
    # What the pages leave of the limit goes to pictures.
    bare = [index, *solver_pages({}).values(), *(board_page(place, ()) for place in range(len(boards)))]
    budget = max(LARGEST_SITE_BYTES - sum(len(page.encode()) for page in bare), 0) // len(boards)
    cards = [make_cards(board, source, budget) for board in boards]
    anchors = {
        (board.file_name, card.label): card.anchor for board, some in zip(boards, cards, strict=True) for card in some
    }
    pages = {"index.html": index, **solver_pages(anchors)}
    return pages | {board.file_name: board_page(place, cards[place]) for place, board in enumerate(boards)}


def render_figure(boards: Sequence[Board]) -> str:
    """The leaderboard as one picture, SVG."""
    view = make_view(boards, make_styles(boards), ".")
    return leaderboard_svg(view)


def style_sheet() -> str:
    """All of the site's style, as it stands in each page."""
    return "\n".join((palette_sheet(), *map(read_sheet, _SHEETS)))


def _templates(styles: Mapping[str, Style]) -> Callable[[str], jinja2.Template]:
    style, script = style_sheet(), read_sheet("site/site.js")
    pages = environment(
        style=Markup(style),
        style_hash=_hash(style),
        script=Markup(script),
        script_hash=_hash(script),
        styles=styles,
        solver_page=solver_page,
        short=columns.SHORT,
        full=columns.FULL,
        calibration=columns.CALIBRATION,
        script_number=columns.script_number,
        break_words=columns.break_words,
        break_interval=columns.break_interval,
        signed=columns.signed,
        p_value=columns.p_value,
        number=number,
        percent=percent,
        interval=interval,
        thousands=lambda n: f"{n:,}".replace(",", "\N{THIN SPACE}"),
    )
    return lambda name: pages.get_template(f"site/{name}")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


@dataclass(frozen=True, eq=False)
class Drawings:
    """One panel to an entry, and the backdrop that they share."""

    backdrop: Markup
    panels: tuple[tuple[Entry, Markup], ...]


def _drawings(entries: Sequence[Entry], drawn: tuple[Markup, list[Markup]]) -> Drawings:
    backdrop, panels = drawn
    return Drawings(backdrop, tuple(zip(entries, panels, strict=True)))


def _board_charts(board: Board, styles: Mapping[str, Style]) -> dict[str, Any]:
    task = board.task
    style_of = {entry.label: styles[entry.stored.solver] for entry in board.entries}
    breaks = [
        Mark(entry.label, style_of[entry.label], _inside(entry), columns.break_words(entry)) for entry in board.entries
    ]
    breaks.sort(key=lambda mark: (math.isnan(mark.estimate.value), -task.harder * mark.estimate.value))
    curves = [(entry.label, style_of[entry.label], entry.levels) for entry in board.entries]
    sure = [entry for entry in board.entries if entry.bins]
    bins = [(e.label, style_of[e.label], [(one.confidence, one.success) for one in e.bins]) for e in sure]
    risks = [(e.label, style_of[e.label], _thinned(e.curve)) for e in sure]
    drawn: dict[str, Any] = {
        "pareto": charts.pareto(
            [(e.label, style_of[e.label], e.metrics["median_time_ms"], e.success) for e in board.entries],
            "Success against median time by solver; the table above has both",
        ),
        "reliability": _drawings(sure, charts.reliabilities(bins, "back-reliability")),
        "risk": _drawings(sure, charts.risk_coverages(risks, "back-risk")),
    }
    if task.by:
        drawn["success"] = _drawings(board.entries, charts.success_curves(curves, task, "back-success"))
        drawn["errors"] = _drawings(board.entries, charts.error_curves(curves, task, "back-errors"))
    if task.graded:
        scale = charts.condition_scale([entry.levels for entry in board.entries], task)
        label = f"Break points by solver over {task.axis}; the table above has them"
        drawn["breaks"] = charts.forest(breaks, scale, label)
    return drawn


def _inside(entry: Entry) -> Estimate:
    """Break point with ends beyond what was tested brought to its edge; NaN where the value itself lies beyond."""
    found, tested = entry.break_point, [level.condition for level in entry.levels]
    if not tested or not math.isfinite(found.value):
        return Estimate(math.nan, math.nan, math.nan, found.n)
    low, high = max(found.low, min(tested)), min(found.high, max(tested))
    return Estimate(found.value, low, high, found.n)


def _success_panel(board: Board, entry: Entry, style: Style) -> Markup:
    others = [other.levels for other in board.entries if other is not entry]
    return charts.success_curve(entry.label, style, entry.levels, others, board.task)


def _thinned(curve: RiskCoverage, most: int = 30) -> list[tuple[float, float]]:
    points = list(zip(curve.coverage.tolist(), curve.risk.tolist(), strict=True))
    stride = max(1, len(points) // most)
    return [*points[::stride], points[-1]] if points else []


def _differences(board: Board) -> list[dict[str, Any]]:
    """Rows of the table of differences: for each pair the difference of success and whether it is certain."""
    known: dict[tuple[str, str], dict[str, Any]] = {}
    for pair in board.comparisons:
        sure = pair.success_p_holm <= 0.05
        known[(pair.first, pair.second)] = {"value": pair.difference.value, "sure": sure}
        known[(pair.second, pair.first)] = {"value": -pair.difference.value, "sure": sure}
    labels = [entry.label for entry in board.entries]
    return [{"label": row, "cells": [known.get((row, column)) for column in labels]} for row in labels]
