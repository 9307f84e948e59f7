"""Axes of the site's figures: positions of values, and labels of ticks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from benchmark.report.formatting import number, tick

Point = tuple[float, float]
Tick = tuple[float, str]
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Scale:
    """Positions of values along an axis: `place` returns 0 to 1, `ticks` are values and their labels."""

    place: Callable[[float], float]
    ticks: tuple[Tick, ...]
    title: str = ""


def share_scale(title: str, step: float = 0.25) -> Scale:
    """Axis from 0 to 100 %."""
    ticks = tuple((n * step, f"{100 * n * step:g} %") for n in range(round(1.0 / step) + 1))
    return Scale(lambda value: min(max(value, 0.0), 1.0), ticks, title)


def log_scale(values: Iterable[float], title: str, refused: bool = False) -> Scale:
    """Logarithmic axis over whole decades around the positive, finite values.

    With `refused`, an additional step at the end represents infinity.
    """
    finite = [value for value in values if math.isfinite(value) and value > 0.0]
    low = math.floor(math.log10(min(finite, default=0.1)) + 1e-9)
    high = max(math.ceil(math.log10(max(finite, default=100.0)) - 1e-9), low + 1)
    end = high + (1.0 if refused else 0.0)
    span = end - low

    def place(value: float) -> float:
        if value == math.inf:
            return 1.0
        top = (high - low) / span
        return 0.0 if value <= 0.0 else min(max((math.log10(value) - low) / span, 0.0), top)

    stride = max(1, math.ceil((high - low) / 5))
    ticks = [(10.0**n, _power(n)) for n in range(low, high + 1, stride)]
    if refused:
        ticks.append((math.inf, "∞"))
    return Scale(place, tuple(ticks), title)


def level_scale(levels: Sequence[float], title: str, most: int = 7) -> Scale:
    """Axis with the graded values of a condition at equal distances; other values are interpolated between them."""
    if len(levels) == 1:
        return Scale(lambda value: 0.5, ((levels[0], number(levels[0])),), title)
    order = sorted(levels)
    last = len(order) - 1

    def place(value: float) -> float:
        if value <= order[0]:
            return 0.0
        for n in range(last):
            if value <= order[n + 1]:
                return (n + (value - order[n]) / (order[n + 1] - order[n])) / last
        return 1.0

    stride = math.ceil(len(order) / most)
    ticks = tuple((value, tick(value)) for value in order[::stride])
    return Scale(place, ticks, title)


def _power(n: int) -> str:
    return f"{10.0**n:g}" if -2 <= n <= 3 else "10" + str(n).translate(_SUPERSCRIPTS)
