"""The four numbers of each solver over several sets of frames, which count equally."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from benchmark.report.site.boards import Board, Entry
from benchmark.report.site.columns import BOUND, LEADING, NAMED, NEES, RISK, SUCCESS, TIME, WRONG, Column
from benchmark.stats.intervals import Estimate
from benchmark.stats.overall import geometric_mean_of, mean_of

COLUMNS = (*LEADING, RISK)
"""Columns that are averaged over all sets of frames."""
_SUCCESS_KEY = "success"
KEYS: dict[Column, str] = {
    SUCCESS: _SUCCESS_KEY,
    NAMED: "stars_named_right",
    BOUND: "identified_bound_ratio",
    NEES: "nees",
    WRONG: "wrong_and_confident",
} | {
    TIME: "median_time_ms",
    RISK: "risk_coverage_area",
}
"""Names of the columns in files."""
_RATIOS = (BOUND, NEES, TIME)
"""Columns in which ratios matter: they are averaged by geometric means, so that no set decides alone."""
_OF_ALL_FRAMES = (RISK,)
"""Columns that depend on the difficulty of a set: a mean over some of the sets would flatter."""


@dataclass(frozen=True, eq=False)
class OverallRow:
    """One solver over all sets of frames.

    Attributes
    ----------
    label : str
    entries : tuple of Entry
        One for each set that it answered.
    n_sets : int
        Number of sets. Where the solver did not answer all of them, its numbers are undefined, because they would be of
        easier or harder frames than those of others.
    metrics : mapping of str to Estimate
        Values of `COLUMNS`, by the metrics' keys. A number that a solver only has on some sets (on the others it has no
        identified fix, or nobody can name the stars) is the mean over these.
    lacking : mapping of str to int
        Number of sets without the number, by key; zeros are omitted.
    """

    label: str
    entries: tuple[Entry, ...]
    n_sets: int
    metrics: Mapping[str, Estimate]
    lacking: Mapping[str, int]

    @property
    def success(self) -> Estimate:
        """Mean of the successes."""
        return self.metrics[_SUCCESS_KEY]

    def lacks(self, column: Column) -> int:
        """Number of sets without the column's number where other solvers have it."""
        return self.lacking.get(KEYS[column], 0)


def overall_rows(boards: Sequence[Board]) -> tuple[OverallRow, ...]:
    """Rows for solvers over boards of different frames, the most successful first; those that did not answer all sets last.

    Parameters
    ----------
    boards : sequence of Board
        One for each set of frames: of one mode of detection, or of any other property by which they may be compared.
    """
    found: defaultdict[str, list[Entry]] = defaultdict(list)
    for board in boards:
        for entry in board.entries:
            found[entry.label].append(entry)
    rows = [_row(label, entries, len(boards)) for label, entries in found.items()]
    return tuple(sorted(rows, key=lambda row: (-_or(row.success.value, -1.0), -len(row.entries), row.label)))


def _row(label: str, entries: Sequence[Entry], n_sets: int) -> OverallRow:
    metrics: dict[str, Estimate] = {}
    lacking: dict[str, int] = {}
    for column in COLUMNS:
        estimates = [column.estimate(entry) for entry in entries]
        known = sum(not math.isnan(one.value) for one in estimates)
        compared = len(entries) == n_sets and (column not in _OF_ALL_FRAMES or known == n_sets)
        combine: Callable[[Sequence[Estimate]], Estimate] = geometric_mean_of if column in _RATIOS else mean_of
        metrics[KEYS[column]] = combine(estimates if compared else [])
        if compared and 0 < known < n_sets:
            lacking[KEYS[column]] = n_sets - known
    return OverallRow(label, tuple(entries), n_sets, metrics, lacking)


def _or(value: float, otherwise: float) -> float:
    return otherwise if math.isnan(value) else value
