"""Columns of the site's tables: their headings, format and sort order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from benchmark.report.formatting import graded, interval, number, percent
from benchmark.report.site.boards import Entry
from benchmark.stats.break_point import tested_around
from benchmark.stats.intervals import Estimate


class Measured(Protocol):
    """Anything that has numbers for columns: an entry of a board, or a solver over several boards."""

    @property
    def metrics(self) -> Mapping[str, Estimate]:
        """By key."""

    @property
    def success(self) -> Estimate:
        """By the limits of the tasks."""


@dataclass(frozen=True)
class Column:
    """One number of an entry.

    `first` is the direction in which the first click on its heading sorts. What is `wide` is left out where there is no room:
    on telephones, and in tables with many other columns.
    """

    heading: str
    hint: str
    estimate: Callable[[Measured], Estimate]
    form: Callable[[float], str]
    first: str
    is_share: bool = False
    wide: bool = False

    def value(self, entry: Measured) -> str:
        """Format the number."""
        return self.form(self.estimate(entry).value)

    def interval(self, entry: Measured) -> str:
        """Format its interval; empty where it has none, and where it excludes nothing."""
        found = self.estimate(entry)
        unbounded = found.low <= 0.0 and found.high == math.inf
        return "" if math.isnan(found.low) or found.low == math.inf or unbounded else interval(found, self.form)

    def sort_key(self, entry: Measured) -> str:
        """Return the number as a script reads it; empty where undefined."""
        return script_number(self.estimate(entry).value)


def script_number(value: float) -> str:
    """Format a number for the page's script; empty where undefined."""
    if math.isnan(value):
        return ""
    return ("-" if value < 0 else "") + "Infinity" if math.isinf(value) else f"{value:.6g}"


def signed(value: float) -> str:
    """Format a difference of shares in percentage points, with its sign."""
    return "—" if math.isnan(value) else f"{round(100.0 * value, 1) + 0.0:+.1f}".replace("-", "−")


def p_value(value: float) -> str:
    """Format a p-value: three decimals, or that it is smaller."""
    return "—" if math.isnan(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def break_words(entry: Entry) -> str:
    """Describe in a few words where the solver breaks."""
    value = entry.break_point.value
    harder = entry.stored.task.harder
    if math.isnan(value):
        return "—"
    if math.isinf(value):
        return "never ≥ 50 %" if value * harder < 0 else "not reached"
    return graded(value)


def break_interval(entry: Entry) -> str:
    """Interval of the break point; an open end is given as the end of the tested range."""
    found, tested = entry.break_point, [level.condition for level in entry.levels]
    if not tested or not math.isfinite(found.value):
        return ""
    low = graded(found.low) if math.isfinite(found.low) else f"< {graded(min(tested))}"
    high = graded(found.high) if math.isfinite(found.high) else f"> {graded(max(tested))}"
    return f"{low} – {high}"


def break_bracket(entry: Entry) -> str:
    """Tested values on both sides of the break point."""
    bracket = tested_around(entry.break_point.value, [level.condition for level in entry.levels])
    return f"tested {graded(bracket[0])} and {graded(bracket[1])}" if bracket else ""


def _metric(key: str) -> Callable[[Measured], Estimate]:
    return lambda entry: entry.metrics[key]


SUCCESS = Column("success", "of all frames", lambda entry: entry.success, percent, "descending", True)
MEDIAN = Column("median error, km", "refused = ∞", _metric("median_error_km"), number, "ascending")
WRONG = Column(
    "wrong and confident", "any fix beyond the limit", _metric("wrong_and_confident"), percent, "ascending", True
)
TIME = Column("median time, ms", "per frame", _metric("median_time_ms"), number, "ascending")
BOUND = Column("error / bound", "median of identified fixes", _metric("identified_bound_ratio"), number, "ascending")
NEES = Column("NEES", "identified fixes; honest: 2", _metric("nees"), number, "ascending")
RISK = Column("risk-coverage area", "0 is perfect", _metric("risk_coverage_area"), number, "ascending")
NAMED = Column("stars named right", "most of a frame's", _metric("stars_named_right"), percent, "descending", wide=True)
LEADING = (SUCCESS, NAMED, BOUND, NEES, WRONG, TIME)
"""The four numbers that lead every table: success (two columns), error over bound, calibration (two columns), time."""
SHORT = (MEDIAN, RISK)
"""Columns of a set's main table after the leading ones, rank and break point."""
_LIMITS = tuple(
    Column(f"{limit} km", "success", _metric(f"success_{limit}km"), percent, "descending", True) for limit in (1, 3, 30)
)
_TAIL = Column("90 % error, km", "refused = ∞", _metric("p90_error_km"), number, "ascending")
_STARS = (
    Column("star-ID precision", "right of claimed", _metric("star_precision"), percent, "descending", True),
    Column("star-ID recall", "right of detected", _metric("star_recall"), percent, "descending", True),
)
_SLOWEST = Column("95 % time, ms", "per frame", _metric("p95_time_ms"), number, "ascending")
MORE = (
    *_LIMITS,
    _TAIL,
    *_STARS,
    Column("Kelvins score", "(right − 2 wrong) / stars", _metric("kelvins_score"), number, "descending"),
    _SLOWEST,
    Column("peak memory, MiB", "largest", _metric("peak_memory_mib"), number, "ascending"),
)
"""Columns of the second table."""
HEADLINE = (*LEADING, MEDIAN, _TAIL, *_STARS, _SLOWEST)
"""Columns that the terminal shows for one set of frames."""
CALIBRATION = (
    Column("calibration error", "0 is perfect", _metric("ece"), percent, "ascending", True),
    Column("overconfidence", "claimed less right, points", _metric("overconfidence"), signed, "ascending"),
    RISK,
    NEES,
    Column("50 % ellipse holds", "honest: 50 %", _metric("ellipse_50"), percent, "descending"),
    Column("95 % ellipse holds", "honest: 95 %", _metric("ellipse_95"), percent, "descending"),
    Column("99 % ellipse holds", "honest: 99 %", _metric("ellipse_99"), percent, "descending"),
)
