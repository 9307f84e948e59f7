"""Figures of a study as SVG in one ink: series differ in shape, filling and dash, so that any printer keeps them apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

WIDTH, HEIGHT = 720, 400
LEFT, RIGHT, TOP, BOTTOM = 66, 16, 14, 52
_DASHES = {"solid": "", "dashed": "7 4", "dotted": "2 4"}


@dataclass(frozen=True)
class Series:
    """Points, in the units of the axes.

    Attributes
    ----------
    name : str
        For the legend; one without a name is not in it.
    x, y : sequence of float
        Infinite or undefined points are left out.
    low, high : sequence of float or None
        Intervals in y.
    shape : str
        ``circle``, ``square``, ``triangle``, ``diamond``, ``dot`` (small, for many) or ``none``.
    filled : bool
    line : str
        ``solid``, ``dashed``, ``dotted`` or ``none``.
    shift_px : float
        Sideways, so that intervals of several series stand side by side.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    shape: str = "circle"
    filled: bool = True
    line: str = "solid"
    shift_px: float = 0.0


@dataclass(frozen=True)
class Axis:
    """An axis: title, ends, ticks and their labels; `log` for a logarithmic one."""

    title: str
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]
    log: bool = False

    def part(self, value: float) -> float:
        """Where a value lies, 0 at the low end and 1 at the high end."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


def plot(series: Sequence[Series], x: Axis, y: Axis, label: str) -> str:
    """Draw series.

    Parameters
    ----------
    series : sequence of Series
    x, y : Axis
        `x.low` may exceed `x.high`: the axis then runs the other way.
    label : str
        What a screen reader says.

    Returns
    -------
    str
        An SVG element without ids; the ink is the page's (currentColor).
    """
    columns = 3
    named = [one for one in series if one.name]
    legend = 22 * math.ceil(len(named) / columns)

    def at_x(value: float) -> float:
        return LEFT + x.part(value) * (WIDTH - LEFT - RIGHT)

    def at_y(value: float) -> float:
        inside = min(max(y.part(max(value, y.low) if y.log else value), 0.0), 1.0)
        return legend + HEIGHT - BOTTOM - inside * (HEIGHT - BOTTOM - TOP)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT + legend}" role="img" '
        f'aria-label="{escape(label)}" font-family="system-ui, sans-serif" font-size="13" fill="currentColor">'
    ]
    bottom, top = legend + HEIGHT - BOTTOM, legend + TOP
    for value, text in y.ticks:
        parts.append(
            f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at_y(value):.1f}" y2="{at_y(value):.1f}" '
            'stroke="currentColor" opacity="0.15"/>'
            f'<text x="{LEFT - 8}" y="{at_y(value) + 4:.1f}" text-anchor="end">{escape(text)}</text>'
        )
    for value, text in x.ticks:
        parts.append(
            f'<line x1="{at_x(value):.1f}" x2="{at_x(value):.1f}" y1="{bottom}" y2="{bottom + 5}" stroke="currentColor"/>'
            f'<text x="{at_x(value):.1f}" y="{bottom + 20}" text-anchor="middle">{escape(text)}</text>'
        )
    parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{bottom}" y2="{bottom}" stroke="currentColor"/>')
    parts.append(
        f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{bottom + 42}" text-anchor="middle">{escape(x.title)}</text>'
        f'<text transform="translate(16 {(top + bottom) / 2}) rotate(-90)" text-anchor="middle">{escape(y.title)}</text>'
    )
    parts += [_draw(one, at_x, at_y) for one in series]
    for number, one in enumerate(named):
        left = LEFT + (number % columns) * (WIDTH - LEFT) / columns
        height = 12 + 22 * (number // columns)
        if one.line != "none":
            parts.append(_line([(left, height), (left + 30, height)], one.line))
        parts.append(_mark(left + 15, height, one))
        parts.append(f'<text x="{left + 38:.1f}" y="{height + 4}">{escape(one.name)}</text>')
    return "".join(parts) + "</svg>"


def _draw(one: Series, at_x: Callable[[float], float], at_y: Callable[[float], float]) -> str:
    parts, points = [], []
    for number, (x, y) in enumerate(zip(one.x, one.y, strict=True)):
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        place = (at_x(x) + one.shift_px, at_y(y))
        points.append(place)
        if one.low is not None and one.high is not None:
            low, high = at_y(one.low[number]), at_y(one.high[number] if math.isfinite(one.high[number]) else 1e300)
            parts.append(
                f'<line x1="{place[0]:.1f}" x2="{place[0]:.1f}" y1="{low:.1f}" y2="{high:.1f}" '
                'stroke="currentColor" stroke-width="1.2"/>'
            )
    if one.line != "none":
        parts.insert(0, _line(points, one.line))
    parts += [_mark(x, y, one) for x, y in points]
    return "".join(parts)


def _line(points: Sequence[tuple[float, float]], line: str) -> str:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dash = f' stroke-dasharray="{_DASHES[line]}"' if _DASHES[line] else ""
    return f'<polyline points="{path}" fill="none" stroke="currentColor" stroke-width="1.4"{dash}/>'


def _mark(x: float, y: float, one: Series) -> str:
    if one.shape == "none":
        return ""
    fill = "currentColor" if one.filled else "var(--paper, white)"
    ink = f'fill="{fill}" stroke="currentColor" stroke-width="1.4"'
    r = 4.5
    if one.shape == "circle":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r}" {ink}/>'
    if one.shape == "dot":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.8" fill="{fill}" stroke="currentColor" stroke-width="0.8"/>'
    corners = {
        "square": [(-r, -r), (r, -r), (r, r), (-r, r)],
        "triangle": [(0, -r - 1), (r + 1, r), (-r - 1, r)],
        "diamond": [(0, -r - 1.5), (r + 1.5, 0), (0, r + 1.5), (-r - 1.5, 0)],
    }[one.shape]
    return f'<polygon points="{" ".join(f"{x + dx:.1f},{y + dy:.1f}" for dx, dy in corners)}" {ink}/>'
