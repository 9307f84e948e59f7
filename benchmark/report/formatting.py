"""Formatting of numbers for tables and pages."""

import math
from collections.abc import Callable

from benchmark.stats.intervals import Estimate


def number(value: float, unit: str = "") -> str:
    """Format with three significant digits, from a million on as ``1.84e9``; ``∞`` for infinity, ``—`` for undefined."""
    if math.isnan(value):
        return "—"
    if math.isinf(value):
        return "∞"
    if value == 0.0:
        text = "0"
    elif abs(value) >= 1e6:
        mantissa, exponent = f"{value:.2e}".split("e")
        text = f"{mantissa}e{int(exponent)}"
    else:
        decimals = max(0, 2 - math.floor(math.log10(abs(value))))
        text = f"{value:,.{min(decimals, 4)}f}".replace(",", "\N{THIN SPACE}")
    return f"{text} {unit}".rstrip()


def graded(value: float) -> str:
    """Format a task's condition with three significant digits, without an exponent: ``0.0809``, ``4``, ``115 000``."""
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.0f}".replace(",", "\N{THIN SPACE}") if abs(rounded) >= 1000 else f"{rounded:g}"


def tick(value: float) -> str:
    """Format a task's condition as the label of an axis, thousands with a k: ``0.003``, ``4k``, ``240k``."""
    return f"{value / 1000:g}k" if abs(value) >= 1000 else f"{value:g}"


def percent(value: float) -> str:
    """Format with one decimal, 0 and 100 % without; ``—`` for undefined."""
    if math.isnan(value):
        return "—"
    return f"{100.0 * value:.0f} %" if value in (0.0, 1.0) else f"{100.0 * value:.1f} %"


def interval(estimate: Estimate, form: Callable[[float], str]) -> str:
    """Format as ``low – high``; empty where the estimate is undefined."""
    if math.isnan(estimate.value):
        return ""
    return f"{form(estimate.low).removesuffix(' %')} – {form(estimate.high)}"


def duration(seconds: float) -> str:
    """Format a duration in a suitable unit: ``42 s``, ``3.5 min``, ``12 h``, ``3 d``."""
    for unit, length, most in (("s", 1.0, 120.0), ("min", 60.0, 120.0), ("h", 3600.0, 72.0)):
        if seconds < most * length:
            return f"{seconds / length:.2g} {unit}" if seconds / length < 10.0 else f"{seconds / length:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} d"


def file_size(count: float) -> str:
    """Format a number of bytes in a suitable unit: ``640 kB``, ``1.2 GB``."""
    for unit, size in (("kB", 1e3), ("MB", 1e6), ("GB", 1e9)):
        if count < 1000.0 * size:
            return f"{count / size:.2g} {unit}" if count / size < 10.0 else f"{count / size:.0f} {unit}"
    return f"{count / 1e12:.2g} TB"
