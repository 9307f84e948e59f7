"""Revisions of the site's rows: marks for its pages, and words for its tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from benchmark.report.marks import Mark, older_digest, sentence_of, source_digest, stated_path
from benchmark.report.site.boards import Board, Entry
from benchmark.report.site.tree import StoredResult
from benchmark.run.freshness import State


@dataclass(frozen=True)
class PageMark:
    """A mark, and the sentence to print on the next line."""

    line: str
    sentence: str


def row_name(stored: StoredResult) -> str:
    """Name of a result in marks."""
    return f"{stored.task.key}/{stored.split}/{stored.detections}/{stored.label}"


def state_of(stored: StoredResult) -> State:
    """State of a result relative to today's code; results of solvers or frames other than skybench's own are never older."""
    if stored.age is not None:
        return stored.age.state
    return State.TODAY if stored.provenance.solver.revision else State.UNRECORDED


def page_mark(entries: Iterable[Entry], patterns: Sequence[str], by: str) -> PageMark:
    """Make the mark of a page or a figure of some results.

    Parameters
    ----------
    entries : iterable of Entry
    patterns : sequence of str
        They match the names (`row_name`) of these results and of no others.
    by : str
        Command that produces it again.
    """
    found = [entry.stored for entry in entries]
    states = {row_name(stored): state_of(stored) for stored in found}
    sources = {stated_path(source): source_digest(source) for source in sorted({stored.source for stored in found})}
    mark = Mark(by, {}, sources, tuple(patterns), older_digest(states))
    return PageMark(mark.line(), sentence_of(mark, states))


def board_pattern(board: Board) -> str:
    """Pattern of the rows of a board."""
    return f"{board.task.key}/{board.split}/{board.detections}/*"


def solver_mark(entries: Sequence[Entry], by: str) -> PageMark:
    """Make the mark of a page with all rows of one solver."""
    return page_mark(entries, sorted({f"*/{entry.label}" for entry in entries}), by)


def entries_of(boards: Sequence[Board]) -> list[Entry]:
    """All entries, board by board."""
    return [entry for board in boards for entry in board.entries]


def not_of_today(entries: Iterable[Entry]) -> int:
    """Number of results that are not known to be of today's code."""
    return sum(state_of(entry.stored) is not State.TODAY for entry in entries)


def revision_words(entry: Entry) -> str:
    """Revision of a result, and what has changed since, for a table."""
    stored = entry.stored
    if stored.age is not None:
        return stored.age.words
    revision = stored.provenance.solver.revision
    return f"revision {revision}" if revision else "states no revision"


def is_older(entry: Entry) -> bool:
    """Whether a result is not known to be of today's code."""
    return state_of(entry.stored) is not State.TODAY
