"""Small figures of one kind, drawn at the size at which they are read.

A page contains hundreds of small panels, one per solver, and must stay light, readable on a telephone and in print, and work
without scripts. What the panels of a row share, above all the axes, is stored once on the page, in a backdrop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from benchmark.report.site.scales import Point, Scale
from generator.drawing.palette import INK, LINE, PAPER, SERIES, SOFT
from generator.drawing.style import LIGHT_PX, axes_at, new_figure
from generator.drawing.svg import inline_svg, svg_marks

MARKERS = {"circle": ("o", 7.0), "square": ("s", 6.4), "triangle": ("^", 8.0), "diamond": ("D", 6.4)}
"""Matplotlib's marker and its size in px, so that all shapes look equally large."""
DOTTED, DASHED = (0.0, (2.0, 3.0)), (0.0, (6.0, 3.0))
_TITLE_PX, _UNIT_PX = 16, 14
_LETTER_PX = 6.8


def colour_of(series: int) -> str:
    """Colour of a solver's series in the light theme."""
    return SERIES[series].light


class Panel:
    """A drawing area with axes; methods add marks in the order in which they are painted.

    Parameters
    ----------
    x, y : Scale
        Axes; `y` runs upwards, and its title is above it.
    width, height : int
        Size of the drawing area, px.
    left, right : int
        Margins next to it, px.
    bare : bool
        Whether to omit axes, so that it can be drawn over the backdrop of a panel of the same size.
    """

    def __init__(
        self, x: Scale, y: Scale, width: int, height: int, left: int = 46, right: int = 20, bare: bool = False
    ) -> None:
        self.x, self.y, self.width, self.height = x, y, width, height
        self.left, self.right, self.top = left, right, 10 + (_UNIT_PX if y.title else 0)
        bottom = 24 + (_TITLE_PX if x.title else 0)
        self._figure = new_figure(left + width + right, self.top + height + bottom)
        self._axes = axes_at(self._figure, left, self.top, width, height)
        self._axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), autoscale_on=False)
        self._marks: list[Artist] = []
        if bare:
            self._axes.set_axis_off()
        else:
            self._label_axes()

    def line(
        self,
        points: Sequence[Point],
        colour: str,
        width: float = 2.0,
        alpha: float = 1.0,
        dashes: tuple[float, tuple[float, ...]] | None = None,
    ) -> None:
        """Draw a polyline; points without a defined value are left out."""
        places = [self._at(point) for point in points if not math.isnan(point[1])]
        if places:
            u, v = zip(*places, strict=True)
            self._add(Line2D(u, v, color=colour, linewidth=width, alpha=alpha, linestyle=dashes or "-"))

    def ghost(self, points: Sequence[Point]) -> None:
        """Draw another series in the background."""
        self.line(points, SOFT.light, LIGHT_PX, 0.28)

    def steps(self, points: Sequence[Point]) -> None:
        """Draw a dotted line that keeps its height up to the next point."""
        corners: list[Point] = []
        for n, (x, y) in enumerate(points):
            if n:
                corners.append((x, points[n - 1][1]))
            corners.append((x, y))
        self.line(corners, SOFT.light, LIGHT_PX, dashes=DOTTED)

    def band(self, low: Sequence[Point], high: Sequence[Point], colour: str) -> None:
        """Fill the area between two lines."""
        outline = [self._at(point) for point in (*low, *reversed(high)) if not math.isnan(point[1])]
        if outline:
            self._add(Polygon(outline, closed=True, facecolor=colour, alpha=0.17, linewidth=0.0))

    def dot(self, point: Point, colour: str, shape: str, title: str = "", size: float = 1.0) -> None:
        """Draw a mark at a point; `title` appears under the pointer."""
        if math.isnan(point[1]) or math.isnan(point[0]):
            return
        u, v = self._at(point)
        marker, size_px = MARKERS[shape]
        dot = Line2D(
            [u], [v], linestyle="", marker=marker, markersize=size * size_px, color=colour, markeredgecolor=PAPER.light
        )
        dot.set_gid(title)
        self._add(dot)

    def whiskers(
        self, ends: Sequence[tuple[Point, Point]], colour: str, width: float = 2.0, alpha: float = 0.6
    ) -> None:
        """Draw interval bars between pairs of points; those with an undefined end are left out."""
        bars = [
            (self._at(start), self._at(end))
            for start, end in ends
            if not any(math.isnan(value) for value in (*start, *end))
        ]
        if bars:
            self._add(LineCollection(bars, colors=[colour], linewidths=[width], alpha=alpha))

    def across(self, value: float) -> None:
        """Draw a dotted line over the whole width at a value of y."""
        place = self.y.place(value)
        self._add(Line2D([0.0, 1.0], [place, place], color=SOFT.light, linewidth=LIGHT_PX, linestyle=DOTTED))

    def uprights(self) -> None:
        """Draw grid lines over the whole height at the ticks of x."""
        bars = [((self.x.place(value), 0.0), (self.x.place(value), 1.0)) for value, _ in self.x.ticks]
        self._add(LineCollection(bars, colors=[LINE.light], linewidths=[LIGHT_PX]))

    def row_text(self, y: float, words: str, du: float, bold: bool = False) -> None:
        """Write at the left edge of a row, `du` px into it, or before it if negative; in bold, or soft for an aside."""
        text = self._axes.text(
            du / self.width,
            self.y.place(y),
            words,
            ha="right" if du < 0.0 else "left",
            va="center_baseline",
            color=(INK if bold else SOFT).light,
            fontweight="bold" if bold else "normal",
        )
        self._add(text)

    def margin_text(self, point: Point, place: float, words: str) -> None:
        """Write in the right margin at a height of 0 to 1, with a thin line from a point."""
        ends = self._at(point), (1.0 + 6.0 / self.width, place)
        self._add(LineCollection([ends], colors=[SOFT.light], linewidths=[0.7], alpha=0.6))
        self._add(self._axes.text(1.0 + 10.0 / self.width, place, words, va="center_baseline", color=INK.light))

    def svg(self, label: str, backdrop: str = "") -> Markup:
        """Return the drawing and discard its marks, so that the panel can be used for the next series.

        Parameters
        ----------
        label : str
            Description of the figure for readers who cannot see it.
        backdrop : str
            Id of a `backdrop` on the same page over which to draw.
        """
        behind = f'<use href="#{escape(backdrop)}"/>' if backdrop else ""
        drawn = inline_svg(self._figure, label, behind)
        self._clear()
        return Markup(drawn)

    def backdrop(self, identity: str) -> Markup:
        """Return axes and marks as a backdrop that other panels of the page share; by itself it draws nothing."""
        marks = svg_marks(self._figure)
        self._clear()
        return Markup(
            '<svg class="panel store" width="0" height="0" aria-hidden="true"><defs>'
            f'<g id="{escape(identity)}" fill="none" stroke-linejoin="round">{marks}</g></defs></svg>'
        )

    def _clear(self) -> None:
        for mark in self._marks:
            mark.remove()
        self._marks.clear()

    def _label_axes(self) -> None:
        axes = self._axes
        axes.set_xticks([self.x.place(value) for value, _ in self.x.ticks], [words for _, words in self.x.ticks])
        axes.set_yticks([self.y.place(value) for value, _ in self.y.ticks], [words for _, words in self.y.ticks])
        if self.x.title:
            # A long title moves to the left rather than out of the drawing.
            most = self.width + self.right - _LETTER_PX / 2.0 * len(self.x.title)
            axes.set_xlabel(self.x.title, x=min(0.5, most / self.width))
        if self.y.title:
            axes.text(-6.0 / self.width, 1.0 + 10.0 / self.height, self.y.title, ha="right", color=SOFT.light)

    def _add(self, mark: Artist) -> None:
        mark.set_clip_on(False)
        if mark.axes is None:
            self._axes.add_artist(mark)
        self._marks.append(mark)

    def _at(self, point: Point) -> Point:
        return self.x.place(point[0]), self.y.place(point[1])
