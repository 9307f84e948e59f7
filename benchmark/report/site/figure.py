"""Figures as plain SVG: panels with axes, drawn at the size at which they are read.

A page holds hundreds of small panels, one per solver, and must stay light, readable on a telephone and in print, and
work without scripts. Vega's drawing of such a panel takes 20 to 30 kB; this one takes 2 to 4. Colours come from the
style sheet by class, so that they follow the page from light to dark.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from benchmark.report.formatting import number, tick

Point = tuple[float, float]
Tick = tuple[float, str]
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Scale:
    """Where values lie along an axis: `place` gives 0 to 1, `ticks` are values and their labels."""

    place: Callable[[float], float]
    ticks: tuple[Tick, ...]
    title: str = ""


def share_scale(title: str, step: float = 0.25) -> Scale:
    """Axis from 0 to 100 %."""
    ticks = tuple((n * step, f"{100 * n * step:g} %") for n in range(round(1.0 / step) + 1))
    return Scale(lambda value: min(max(value, 0.0), 1.0), ticks, title)


def log_scale(values: Iterable[float], title: str, refused: bool = False) -> Scale:
    """Logarithmic axis over whole decades around the positive, finite values.

    With `refused`, one more step at the end stands for infinity.
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
    """Axis on which the graded values of a condition stand at equal distances, with values between them between."""
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


class Panel:
    """A drawing area with axes; methods add marks in the order in which they are painted.

    Parameters
    ----------
    x, y : Scale
        Axes; `y` runs upwards.
    width, height : int
        Of the drawing area, px.
    label : str
        What the figure shows, for those who cannot see it.
    left : int
        Room for the labels of the y axis, px.
    css : str
        Class of the whole panel, which sets its colour.
    backdrop : str
        Id of a `backdrop` on the same page that is drawn instead of axes; empty for axes of its own.
    """

    def __init__(
        self, x: Scale, y: Scale, width: int, height: int, label: str, left: int = 46, css: str = "", backdrop: str = ""
    ) -> None:
        self.x, self.y, self.width, self.height, self.label = x, y, width, height, label
        self._css, self._backdrop = css, backdrop
        self.left, self.right, self.top = left, 20, 10
        self.bottom = 40 if x.title else 24
        self._marks: list[str] = []

    def line(self, points: Sequence[Point], css: str) -> None:
        """Polyline; points without a finite place are left out."""
        path = " ".join(self._at(point) for point in points if not math.isnan(point[1]))
        if path:
            self._marks.append(f'<polyline class="{css}" points="{path}"/>')

    def steps(self, points: Sequence[Point], css: str) -> None:
        """Polyline that keeps its height up to the next point."""
        corners: list[Point] = []
        for n, (x, y) in enumerate(points):
            if n:
                corners.append((x, points[n - 1][1]))
            corners.append((x, y))
        self.line(corners, css)

    def band(self, low: Sequence[Point], high: Sequence[Point], css: str) -> None:
        """Area between two lines."""
        outline = [point for point in (*low, *reversed(high)) if not math.isnan(point[1])]
        if outline:
            self._marks.append(f'<polygon class="{css}" points="{" ".join(map(self._at, outline))}"/>')

    def dot(self, point: Point, css: str, title: str = "", radius: float = 3.5, shape: str = "circle") -> None:
        """Mark at a point; `title` shows under the pointer."""
        if math.isnan(point[1]) or math.isnan(point[0]):
            return
        u, v = self._uv(point)
        inner = f"<title>{escape(title)}</title>" if title else ""
        r = radius
        if shape == "circle":
            self._marks.append(f'<circle class="{css}" cx="{_px(u)}" cy="{_px(v)}" r="{r:g}">{inner}</circle>')
            return
        outlines = {
            "square": f"M{u - r:.1f} {v - r:.1f}h{2 * r:g}v{2 * r:g}h{-2 * r:g}z",
            "triangle": f"M{u:.1f} {v - 1.2 * r:.1f}l{1.2 * r:g} {2 * r:g}h{-2.4 * r:g}z",
            "diamond": f"M{u:.1f} {v - 1.35 * r:.1f}l{1.35 * r:g} {1.35 * r:g}l{-1.35 * r:g} {1.35 * r:g}"
            f"l{-1.35 * r:g} {-1.35 * r:g}z",
        }
        self._marks.append(f'<path class="{css}" d="{outlines[shape]}">{inner}</path>')

    def whisker(self, start: Point, end: Point, css: str) -> None:
        """Interval bar between two points."""
        if any(math.isnan(value) for value in (*start, *end)):
            return
        (u1, v1), (u2, v2) = self._uv(start), self._uv(end)
        self._marks.append(f'<path class="{css}" d="M{_px(u1)} {_px(v1)}L{_px(u2)} {_px(v2)}"/>')

    def across(self, value: float, css: str = "limit") -> None:
        """Line over the whole width at a value of y."""
        v = self._uv((0.0, value))[1]
        self._marks.append(f'<path class="{css}" d="M{self.left} {v:.1f}h{self.width}"/>')

    def upright(self, value: float, css: str = "limit") -> None:
        """Line over the whole height at a value of x."""
        u = self.left + self.width * self.x.place(value)
        self._marks.append(f'<path class="{css}" d="M{u:.1f} {self.top}v{self.height}"/>')

    def text(self, point: Point, words: str, css: str, anchor: str = "start", du: float = 0.0, dv: float = 4.0) -> None:
        """Words beside a point."""
        u, v = self._uv(point)
        self._marks.append(
            f'<text class="{css}" x="{u + du:.1f}" y="{v + dv:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
        )

    def leader(self, point: Point, place: float, css: str) -> None:
        """Thin line from a point to the right margin, at a height of 0 to 1."""
        u, v = self._uv(point)
        end = self.top + self.height * (1.0 - place)
        self._marks.append(f'<path class="{css}" d="M{u:.1f} {v:.1f}L{self.left + self.width + 6} {end:.1f}"/>')

    def margin_text(self, place: float, words: str) -> None:
        """Words in the right margin at a height of 0 to 1."""
        u, v = self.left + self.width + 10, self.top + self.height * (1.0 - place) + 4
        self._marks.append(f'<text x="{u}" y="{v:.1f}">{escape(words)}</text>')

    def svg(self) -> Markup:
        """Return the whole drawing."""
        across, down = self.left + self.width + self.right, self.top + self.height + self.bottom
        return Markup(
            f'<svg class="{f"panel {self._css}".rstrip()}" viewBox="0 0 {across} {down}" width="{across}" '
            f'height="{down}" role="img" aria-label="{escape(self.label)}">{self._behind()}{"".join(self._marks)}</svg>'
        )

    def backdrop(self, identity: str) -> Markup:
        """Return axes and marks as a backdrop that other panels of the page share; it draws nothing by itself."""
        return Markup(
            f'<svg class="panel store" width="0" height="0" aria-hidden="true"><defs><g id="{escape(identity)}">'
            f"{self._axes()}{''.join(self._marks)}</g></defs></svg>"
        )

    def _behind(self) -> str:
        return f'<use href="#{escape(self._backdrop)}"/>' if self._backdrop else self._axes()

    def _axes(self) -> str:
        base, right = self.top + self.height, self.left + self.width
        grid, labels = [], []
        for value, words in self.y.ticks:
            v = base - self.height * self.y.place(value)
            grid.append(f"M{self.left} {v:.1f}h{self.width}")
            labels.append(f'<text x="{self.left - 6}" y="{v + 4:.1f}" text-anchor="end">{escape(words)}</text>')
        marks = []
        for value, words in self.x.ticks:
            u = self.left + self.width * self.x.place(value)
            marks.append(f"M{u:.1f} {base}v4")
            labels.append(f'<text x="{u:.1f}" y="{base + 17}" text-anchor="middle">{escape(words)}</text>')
        if self.x.title:
            # A long title moves left rather than out of the drawing; a letter takes about 6.4 px.
            middle = min(self.left + self.width / 2, right + self.right - 3.2 * len(self.x.title))
            labels.append(f'<text x="{middle:.1f}" y="{base + 34}" text-anchor="middle">{escape(self.x.title)}</text>')
        axis = f"M{self.left} {base}H{right}{''.join(marks)}"
        return (
            f'<path class="grid" d="{"".join(grid)}"/><path class="axis" d="{axis}"/><g class="tick">'
            f"{''.join(labels)}</g>"
        )

    def _uv(self, point: Point) -> Point:
        u = self.left + self.width * self.x.place(point[0])
        return u, self.top + self.height * (1.0 - self.y.place(point[1]))

    def _at(self, point: Point) -> str:
        u, v = self._uv(point)
        return f"{_px(u)},{_px(v)}"


def _px(value: float) -> str:
    """A length to a tenth of a pixel, without a zero at its end."""
    return f"{value:.1f}".removesuffix(".0")
