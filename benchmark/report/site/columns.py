"""Columns of the site's tables: what each is called, how it is printed and how it sorts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from benchmark.report.formatting import graded, interval, number, percent
from benchmark.report.site.boards import Entry
from benchmark.stats.intervals import Estimate


@dataclass(frozen=True)
class Column:
    """One number of an entry; `first` is the direction in which a first press on its heading sorts."""

    heading: str
    hint: str
    estimate: Callable[[Entry], Estimate]
    form: Callable[[float], str]
    first: str
    is_share: bool = False

    def value(self, entry: Entry) -> str:
        """Print the number."""
        return self.form(self.estimate(entry).value)

    def interval(self, entry: Entry) -> str:
        """Print its interval; empty where it has none."""
        found = self.estimate(entry)
        return "" if math.isnan(found.low) or found.low == math.inf else interval(found, self.form)

    def sort_key(self, entry: Entry) -> str:
        """Return the number as a script reads it; empty where undefined."""
        return script_number(self.estimate(entry).value)


def script_number(value: float) -> str:
    """Print a number for the page's script; empty where undefined."""
    if math.isnan(value):
        return ""
    return ("-" if value < 0 else "") + "Infinity" if math.isinf(value) else f"{value:.6g}"


def signed(value: float) -> str:
    """Print a difference of shares in points, with its sign."""
    return "—" if math.isnan(value) else f"{round(100.0 * value, 1) + 0.0:+.1f}".replace("-", "−")


def p_value(value: float) -> str:
    """Print a p-value: three decimals, or that it is below them."""
    return "—" if math.isnan(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def break_words(entry: Entry) -> str:
    """Where the solver breaks, in a few words."""
    value = entry.break_point.value
    harder = entry.stored.task.harder
    if math.isnan(value):
        return "—"
    if math.isinf(value):
        return "never ≥ 50 %" if value * harder < 0 else "not reached"
    return graded(value)


def break_interval(entry: Entry) -> str:
    """Its interval, an open end as the end of what was tested."""
    found, tested = entry.break_point, [level.condition for level in entry.levels]
    if not tested or not math.isfinite(found.value):
        return ""
    low = graded(found.low) if math.isfinite(found.low) else f"< {graded(min(tested))}"
    high = graded(found.high) if math.isfinite(found.high) else f"> {graded(max(tested))}"
    return f"{low} – {high}"


def _metric(key: str) -> Callable[[Entry], Estimate]:
    return lambda entry: entry.metrics[key]


SUCCESS = Column("success", "of all frames", lambda entry: entry.success, percent, "descending", True)
MEDIAN = Column("median error, km", "refused = ∞", _metric("median_error_km"), number, "ascending")
WRONG = Column("wrong and confident", "a fix ≥ 10 km off", _metric("wrong_and_confident"), percent, "ascending", True)
TIME = Column("median time, ms", "per frame", _metric("median_time_ms"), number, "ascending")
BOUND = Column("error / bound", "median; Cramér-Rao", _metric("bound_ratio"), number, "ascending")
KEY = (SUCCESS, MEDIAN)
"""Columns that stand next to the name, in sight on a telephone."""
SHORT = (WRONG, BOUND, TIME)
"""Columns of the main tables after rank and break point."""
FULL = (
    SUCCESS,
    Column("1 km", "success", _metric("success_1km"), percent, "descending", True),
    Column("3 km", "success", _metric("success_3km"), percent, "descending", True),
    Column("30 km", "success", _metric("success_30km"), percent, "descending", True),
    MEDIAN,
    Column("90 % error, km", "refused = ∞", _metric("p90_error_km"), number, "ascending"),
    WRONG,
    BOUND,
    Column("star-ID precision", "right of claimed", _metric("star_precision"), percent, "descending", True),
    Column("star-ID recall", "right of detected", _metric("star_recall"), percent, "descending", True),
    Column("Kelvins score", "(right − 2 wrong) / stars", _metric("kelvins_score"), number, "descending"),
    TIME,
    Column("95 % time, ms", "per frame", _metric("p95_time_ms"), number, "ascending"),
    Column("peak memory, MiB", "largest", _metric("peak_memory_mib"), number, "ascending"),
)
MORE = tuple(column for column in FULL if column not in (*KEY, *SHORT))
"""Columns of the second table."""
HEADLINE = tuple(
    column
    for column in FULL
    if column.heading not in {"1 km", "3 km", "30 km", "Kelvins score", "error / bound", "peak memory, MiB"}
)
"""What the terminal shows of one set of frames."""
CALIBRATION = (
    Column("calibration error", "0 is perfect", _metric("ece"), percent, "ascending", True),
    Column("overconfidence", "claimed less right, points", _metric("overconfidence"), signed, "ascending"),
    Column("risk-coverage area", "0 is perfect", _metric("risk_coverage_area"), number, "ascending"),
    Column("50 % ellipse holds", "honest: 50 %", _metric("ellipse_50"), percent, "descending"),
    Column("95 % ellipse holds", "honest: 95 %", _metric("ellipse_95"), percent, "descending"),
    Column("99 % ellipse holds", "honest: 99 %", _metric("ellipse_99"), percent, "descending"),
)
