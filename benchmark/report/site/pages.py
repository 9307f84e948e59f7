"""Writing of the site: one page for the leaderboard, two for each board, one for each solver, with pictures."""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from benchmark.report.formatting import interval, number, percent
from benchmark.report.site import charts, columns
from benchmark.report.site.boards import Board, Entry, make_board
from benchmark.report.site.charts import Mark, Style
from benchmark.report.site.commands import Places, commands_of, report_command
from benchmark.report.site.failures import KINDS, Failure, counts_by_kind, failures_of, listed
from benchmark.report.site.frame_source import FrameSource
from benchmark.report.site.leaderboard_figure import leaderboard_svg
from benchmark.report.site.overall import SHOWN as OVERALL_COLUMNS
from benchmark.report.site.pictures import (
    MOST_PICTURES,
    Pictures,
    remove_others,
    worst_cards,
    write_into,
    write_pictures,
)
from benchmark.report.site.revisions import (
    board_pattern,
    entries_of,
    is_older,
    not_of_today,
    page_mark,
    revision_words,
    solver_mark,
)
from benchmark.report.site.site_view import make_styles, make_view, solver_page
from benchmark.report.site.task_groups import group_of
from benchmark.report.site.tree import Tell, read_tree, untold, whole_results
from benchmark.report.site.words import board_provenance, board_verdict, detectable_words, processor_words
from benchmark.report.templates import environment, read_sheet
from benchmark.run.results import writing
from benchmark.stats.confidence import RiskCoverage
from benchmark.stats.intervals import Estimate
from generator.drawing.palette import palette_sheet

SITE_FOLDER = "site"
_SHEETS = ("page.css", "figure.css", "site/site.css")
_SCRIPTS = ("site.js", "failures.js")


def make_boards(
    root: Path, progress: Callable[[int, int], None] = lambda done, of: None, tell: Tell = untold
) -> list[Board]:
    """Compare all results of a tree, board by board; those on a part of the frames of others on their board are left out.

    Parameters
    ----------
    root : Path
        Tree of results.
    progress : callable
        Called with the number of boards that are done and the total.
    tell : callable
        Called with each result that is left out.

    Raises
    ------
    ResultsError
        There are no results, damaged ones, or some that cannot be compared.
    """
    groups = read_tree(root, tell)
    boards = []
    for done, group in enumerate(groups):
        progress(done, len(groups))
        boards.append(make_board(whole_results(group, tell)))
    progress(len(groups), len(groups))
    return boards


def write_site(boards: Sequence[Board], places: Places, most_pictures: int = MOST_PICTURES) -> Path:
    """Write the report to the folder ``site`` of the results; files of an earlier report are removed.

    Parameters
    ----------
    boards : sequence of Board
    places : Places
        Folders of results and frames, as the user named them.
    most_pictures : int
        Number of pictures for each set of frames; other failures are listed without one.

    Returns
    -------
    Path
        Path of the first page.

    Raises
    ------
    ResultsError
        A picture is damaged, or the pages cannot be written in their folder.
    """
    folder, source = places.out / SITE_FOLDER, FrameSource(places.data)
    with writing(folder):
        failed = [failures_of(board) for board in boards]
        pictures = [
            write_pictures(board, failures, source, folder, most_pictures)
            for board, failures in zip(boards, failed, strict=True)
        ]
        pages = render_site(boards, failed, pictures, places)
        for name, text in (*shared_files().items(), *pages.items()):
            write_into(folder, name, text.encode())
        for old in folder.glob("*.html"):
            if old.name not in pages:
                old.unlink()
        remove_others(folder, pictures)
    return folder / "index.html"


def render_site(
    boards: Sequence[Board], failed: Sequence[Sequence[Failure]], pictures: Sequence[Pictures], places: Places
) -> dict[str, str]:
    """Render all pages, by file name; they need the `shared_files` next to them.

    Parameters
    ----------
    boards : sequence of Board
    failed : sequence of sequence of Failure
        Failures of each board.
    pictures : sequence of Pictures
        Pictures of each board.
    places : Places
    """
    styles = make_styles(boards)
    view = make_view(boards, styles, places)
    template = _templates(styles, view.name)
    by = report_command(places)
    pages = {
        "index.html": template("index.html").render(
            site=view, processor_words=processor_words(boards), mark=page_mark(entries_of(boards), ["*"], by)
        )
    }
    anchors = {}
    for board, failures, shown in zip(boards, failed, pictures, strict=True):
        cards = worst_cards(board, shown)
        anchors.update({(board.file_name, card.label): card.anchor for card in cards})
        commands = commands_of([(board, board.entries)], places)
        pages[board.file_name] = template("board.html").render(
            board=board,
            siblings=[one for one in boards if one.task.key == board.task.key and one is not board],
            verdict=board_verdict(board),
            detectable_words=detectable_words(board),
            processor_words=processor_words([board]),
            charts=_board_charts(board, styles),
            differences=_differences(board),
            cards=cards,
            n_failures=len(failures),
            more_rows=[(entry.label, entry) for entry in board.entries],
            provenance=board_provenance(board),
            commands=commands,
            mark=page_mark(board.entries, [board_pattern(board)], by),
        )
        pages[board.failures_file_name] = _failures_page(template, board, failures, shown, places)
    for solver in view.solvers:
        curves = [
            (board, _success_panel(board, entry, styles[solver.name]))
            for board, entry in solver.entries
            if board.task.by
        ]
        commands = commands_of([(board, [entry]) for board, entry in solver.entries], places)
        pages[solver.file_name] = template("solver.html").render(
            solver=solver,
            curves=curves,
            more_rows=[(f"{board.task.key}, {board.detections}", entry) for board, entry in solver.entries],
            anchors=anchors,
            commands=commands,
            mark=solver_mark([entry for _, entry in solver.entries], by),
        )
    return pages


def _failures_page(
    template: Callable[[str], jinja2.Template],
    board: Board,
    failures: Sequence[Failure],
    pictures: Pictures,
    places: Places,
) -> str:
    """The page that lists all failures of a board; its script shows the requested part of its data."""
    commands = commands_of([(board, board.entries)], places)
    more = f"{commands[-1]} --pictures {MOST_PICTURES * 10}"
    content = listed(board, failures) | {
        "pictures": pictures.frames,
        "overlays": [[place, frame_id, path] for (place, frame_id), path in pictures.overlays.items()],
        "without": (f"No picture of this frame was written. For more: {more}" if pictures.at_hand else "")
        or "Its frames were not at hand for the report. They come with the first of the commands below.",
    }
    return template("failures.html").render(
        board=board,
        counts=counts_by_kind(board, failures),
        kinds=KINDS,
        n_failures=len(failures),
        mark=page_mark(board.entries, [board_pattern(board)], report_command(places)),
        n_pictures=len(pictures.frames),
        packed=pack_data(content),
        commands=commands if not pictures.at_hand else (*commands[:-1], more),
    )


def pack_data(content: Mapping[str, Any]) -> str:
    """Pack data for a page's script: compressed JSON."""
    return fold(json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")))


def fold(text: str) -> str:
    """Compress text for a page's script by gzip, in base64; the same text gives the same result."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode("ascii")


def render_figure(boards: Sequence[Board], places: Places, figure: Path) -> str:
    """Render the leaderboard as one SVG picture, for a file of that name."""
    view = make_view(boards, make_styles(boards), places)
    return leaderboard_svg(view, page_mark(entries_of(boards), ["*"], report_command(places, figure)))


def shared_files() -> dict[str, str]:
    """Style sheet and scripts that all pages share, by file name."""
    style = "\n".join((palette_sheet(), *map(read_sheet, _SHEETS)))
    return {"site.css": style} | {name: read_sheet(f"site/{name}") for name in _SCRIPTS}


def _templates(styles: Mapping[str, Style], name: str) -> Callable[[str], jinja2.Template]:
    pages = environment(
        fold=fold,
        group_of=group_of,
        site_name=name,
        success=columns.SUCCESS,
        styles=styles,
        solver_page=solver_page,
        leading=columns.LEADING,
        overall_columns=OVERALL_COLUMNS,
        short=columns.SHORT,
        more=columns.MORE,
        calibration=columns.CALIBRATION,
        script_number=columns.script_number,
        break_words=columns.break_words,
        break_interval=columns.break_interval,
        break_bracket=columns.break_bracket,
        signed=columns.signed,
        p_value=columns.p_value,
        revision_words=revision_words,
        is_older=is_older,
        not_of_today=not_of_today,
        number=number,
        percent=percent,
        interval=interval,
        thousands=lambda n: f"{n:,}".replace(",", "\N{THIN SPACE}"),
    )
    return lambda name: pages.get_template(f"site/{name}")


@dataclass(frozen=True, eq=False)
class Drawings:
    """One panel per entry, and the backdrop that they share."""

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
    doubting = [entry for entry in board.entries if entry.curve.n_confidences > 1]
    risks = [(e.label, style_of[e.label], _thinned(e.curve), e.curve.n_fixes / board.n_frames) for e in doubting]
    drawn: dict[str, Any] = {
        "pareto": charts.pareto(
            [(e.label, style_of[e.label], e.metrics["median_time_ms"], e.success) for e in board.entries],
            "Success against median time by solver; the table above has both",
        ),
        "reliability": _drawings(sure, charts.reliabilities(bins, "back-reliability")),
        "risk": _drawings(doubting, charts.risk_coverages(risks, "back-risk")),
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
    """Break point with its interval cut to the tested range; NaN where the value itself is infinite."""
    found, tested = entry.break_point, [level.condition for level in entry.levels]
    if not tested or not math.isfinite(found.value):
        return Estimate(math.nan, math.nan, math.nan, found.n)
    low, high = max(found.low, min(tested)), min(found.high, max(tested))
    return Estimate(found.value, low, high, found.n)


def _success_panel(board: Board, entry: Entry, style: Style) -> Markup:
    others = [other.levels for other in board.entries if other is not entry]
    return charts.success_curve(entry.label, style, entry.levels, others, board.task)


def _thinned(curve: RiskCoverage, most: int = 16) -> list[tuple[float, float]]:
    """Thin the curve's points, keeping the last fix and the last frame; level stretches are reduced to their ends."""
    n = len(curve.coverage)
    ends = {curve.n_fixes - 1, n - 1} - {-1}
    kept = sorted({*range(0, n, max(1, n // most)), *ends})
    risk = curve.risk
    turns = [
        place
        for before, place, after in zip([None, *kept], kept, [*kept[1:], None], strict=False)
        if place in ends or before is None or after is None or not risk[before] == risk[place] == risk[after]
    ]
    return [(float(curve.coverage[place]), float(risk[place])) for place in turns]


def _differences(board: Board) -> list[dict[str, Any]]:
    """Rows of the table of differences: for each pair, the difference of success and whether it is significant."""
    known: dict[tuple[str, str], dict[str, Any]] = {}
    for pair in board.comparisons:
        sure = pair.success_p_holm <= 0.05
        known[(pair.first, pair.second)] = {"value": pair.difference.value, "sure": sure}
        known[(pair.second, pair.first)] = {"value": -pair.difference.value, "sure": sure}
    labels = [entry.label for entry in board.entries]
    return [{"label": row, "cells": [known.get((row, column)) for column in labels]} for row in labels]
