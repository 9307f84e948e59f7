"""The report's figures, as SVG that takes its colours from the page.

Series differ in colour, in the shape of their points and in the dash of their lines, so that the figures survive a
black-and-white printer. The SVG carries `currentColor` and CSS variables ``--series-N``; the page's style sheet gives
them values for light and dark.
"""

import io
import math
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import altair as alt

from benchmark.run.results import SolverResult
from benchmark.stats.intervals import Estimate
from benchmark.stats.metrics import SUCCESS_KM, Summary

WIDTH_PX, HEIGHT_PX = 350, 235
# Stand-ins of the CSS variables while Vega draws: it needs real colours to compute with.
_STAND_IN = tuple(f"#0a0b{n:02x}" for n in range(8))
_DASHES = ([1, 0], [6, 3], [2, 2], [8, 3, 2, 3], [10, 4], [1, 3], [4, 1], [12, 2])
_SHAPES = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "triangle-right", "triangle-left")
# Opacity of interval bars.
_BAR, _FAINT_BAR = 0.85, 0.22
MAX_SERIES = len(_STAND_IN)

Rows = list[dict[str, Any]]


def recall_by_bortle(results: Sequence[SolverResult]) -> str:
    """Recall against Bortle class with 95 % intervals, SVG."""
    return _svg(_shares(results, lambda summary: summary.recall, "recall (error < 10 km)"), "recall")


def star_recall_by_bortle(results: Sequence[SolverResult]) -> str:
    """Star-identification recall against Bortle class with 95 % intervals, SVG."""
    return _svg(_shares(results, lambda summary: summary.star_recall, "star-ID recall"), "star-recall")


def median_error_by_bortle(results: Sequence[SolverResult]) -> str:
    """Median error against Bortle class on a logarithmic axis, with 95 % intervals and every frame's error, SVG.

    The topmost tick stands for refused: an infinite median lies there, and an interval without upper end reaches it.
    """
    axis = _LogAxis.around(score.error_km for result in results for score in result.scores)
    rows: Rows = []
    for result in results:
        for bortle, summary in result.bortle:
            estimate = summary.median_error_km
            # A bar over the whole axis says only that there are too few frames; it stays in the background.
            bounded = estimate.low > 0.0 or math.isfinite(estimate.high)
            ends = {"value": estimate.value, "low": estimate.low, "high": estimate.high}
            rows.append(
                {"solver": result.solver, "bortle": _label(bortle), "weight": _BAR if bounded else _FAINT_BAR}
                | {name: axis.place(value) for name, value in ends.items()}
            )
    frames: Rows = [
        {"solver": result.solver, "bortle": _label(score.bortle), "value": axis.place(score.error_km)}
        for result in results
        for score in result.scores
    ]
    y = partial(alt.Y, title="median error, km", axis=axis.axis(), scale=axis.scale())
    base = _by_class(rows, results, y, limit=SUCCESS_KM)
    dots = (
        alt.Chart(alt.Data(values=frames))
        .mark_point(size=16, opacity=0.6, filled=True, strokeWidth=0)
        .encode(
            x=_class_axis(),
            xOffset=alt.XOffset("solver:N", sort=_names(results)),
            y=y("value:Q"),
            color=_color(results),
            shape=_shape(results),
        )
    )
    return _svg(alt.layer(dots, base), "median")


def error_distribution(results: Sequence[SolverResult]) -> str:
    """Share of all frames with an error up to x, logarithmic; refused frames join at the right end, SVG."""
    axis = _LogAxis.around(score.error_km for result in results for score in result.scores)
    rows: Rows = []
    for result in results:
        errors = sorted(axis.place(score.error_km) for score in result.scores)
        points = [(axis.low, 0.0)] + [(error, (n + 1) / len(errors)) for n, error in enumerate(errors)]
        points.append((axis.refused, 1.0))
        rows += [{"solver": result.solver, "error": x, "share": y, "order": n} for n, (x, y) in enumerate(points)]
    chart = (
        alt.Chart(alt.Data(values=rows))
        .mark_line(interpolate="step-after", strokeWidth=2)
        .encode(
            x=alt.X("error:Q", title="error, km", axis=axis.axis(), scale=axis.scale()),
            y=alt.Y("share:Q", title="share of all frames", axis=alt.Axis(format="%", tickCount=6)).scale(
                alt.Scale(domain=[0, 1])
            ),
            order="order:Q",
            color=_color(results, symbol_size=600),
            strokeDash=_dash(results),
        )
    )
    limit = (
        alt.Chart(alt.Data(values=[{"error": SUCCESS_KM}]))
        .mark_rule(color="currentColor", opacity=0.5, strokeDash=[2, 3])
        .encode(x=alt.X("error:Q", scale=axis.scale()))
    )
    return _svg(alt.layer(limit, chart), "distribution")


def _shares(results: Sequence[SolverResult], metric: Callable[[Summary], Estimate], title: str) -> alt.LayerChart:
    rows: Rows = []
    for result in results:
        for bortle, summary in result.bortle:
            estimate = metric(summary)
            if math.isnan(estimate.value):
                continue
            rows.append(
                {
                    "solver": result.solver,
                    "bortle": _label(bortle),
                    "value": estimate.value,
                    "low": estimate.low,
                    "high": estimate.high,
                    "weight": _BAR,
                }
            )
    y = partial(alt.Y, title=title, axis=alt.Axis(format="%", tickCount=6), scale=alt.Scale(domain=[0, 1]))
    return _by_class(rows, results, y)


class _LogAxis:
    """A logarithmic axis in km from whole decade to whole decade, with one more tick for refused frames."""

    def __init__(self, low: float, high: float) -> None:
        self.low = low
        self.refused = high * 10.0
        decades = round(math.log10(high / low))
        # A decade of its own keeps the refused apart from the largest error.
        self.ticks = [low * 10.0**n for n in range(decades + 1)] + [self.refused]

    @classmethod
    def around(cls, errors_km: Iterable[float]) -> "_LogAxis":
        finite = [max(error, 1e-3) for error in errors_km if math.isfinite(error)]
        low = min(finite, default=1.0)
        high = max(finite, default=SUCCESS_KM)
        bottom = 10.0 ** min(math.floor(math.log10(low)), 0)
        return cls(bottom, 10.0 ** max(math.ceil(math.log10(high)), 2))

    def place(self, error_km: float) -> float:
        """Where an error goes: below the axis at its low end, infinite at the tick for refused."""
        return self.refused if math.isinf(error_km) else max(error_km, self.low)

    def scale(self) -> alt.Scale:
        return alt.Scale(type="log", domain=[self.low, self.refused], nice=False)

    def axis(self) -> alt.Axis:
        labels = f"datum.value > {self.refused * 0.99} ? 'refused' : format(datum.value, ',~r')"
        return alt.Axis(values=self.ticks, labelExpr=labels, labelOverlap=False)


def _by_class(
    rows: Rows, results: Sequence[SolverResult], y: Callable[[str], alt.Y], limit: float | None = None
) -> alt.LayerChart:
    base = alt.Chart(alt.Data(values=rows)).encode(
        x=_class_axis(),
        xOffset=alt.XOffset("solver:N", sort=_names(results)),
        color=_color(results),
    )
    layers = [
        base.mark_rule(strokeWidth=1.5).encode(
            y=y("low:Q"), y2="high:Q", opacity=alt.Opacity("weight:Q", scale=None, legend=None)
        ),
        base.mark_point(size=60, filled=True, opacity=1).encode(y=y("value:Q"), shape=_shape(results)),
    ]
    if limit is not None:
        rule = alt.Chart(alt.Data(values=[{"value": limit}])).mark_rule(
            color="currentColor", opacity=0.5, strokeDash=[2, 3]
        )
        layers.insert(0, rule.encode(y=y("value:Q")))
    return alt.layer(*layers)


def _class_axis() -> alt.X:
    return alt.X("bortle:N", sort=None, title="Bortle class", axis=alt.Axis(labelAngle=0, ticks=False, labelPadding=6))


def _names(results: Sequence[SolverResult]) -> list[str]:
    return [result.solver for result in results]


def _color(results: Sequence[SolverResult], symbol_size: int = 90) -> alt.Color:
    scale = alt.Scale(domain=_names(results), range=list(_STAND_IN[: len(results)]))
    return alt.Color("solver:N", scale=scale, legend=alt.Legend(title=None, symbolSize=symbol_size))


def _shape(results: Sequence[SolverResult]) -> alt.Shape:
    return alt.Shape("solver:N", scale=alt.Scale(domain=_names(results), range=list(_SHAPES[: len(results)])))


def _dash(results: Sequence[SolverResult]) -> alt.StrokeDash:
    return alt.StrokeDash("solver:N", scale=alt.Scale(domain=_names(results), range=list(_DASHES[: len(results)])))


def _label(bortle: int | None) -> str:
    return "none" if bortle is None else str(bortle)


def _svg(chart: alt.LayerChart, prefix: str) -> str:
    styled = (
        chart.properties(width=WIDTH_PX, height=HEIGHT_PX)
        .configure(background="transparent", font="system-ui, sans-serif")
        .configure_view(stroke=None)
        .configure_axis(
            labelColor="currentColor",
            titleColor="currentColor",
            domainColor="currentColor",
            tickColor="currentColor",
            gridColor="currentColor",
            gridOpacity=0.13,
            domainOpacity=0.5,
            tickOpacity=0.5,
            labelFontSize=12,
            titleFontSize=13,
            titleFontWeight="normal",
            titlePadding=8,
        )
        .configure_axisX(grid=False)
        .configure_legend(
            orient="top",
            direction="horizontal",
            labelColor="currentColor",
            labelFontSize=13,
            labelLimit=240,
            symbolStrokeWidth=2,
            symbolOpacity=1,
            columnPadding=36,
        )
    )
    stream = io.StringIO()
    styled.save(stream, format="svg")
    svg = stream.getvalue()
    for n, stand_in in enumerate(_STAND_IN):
        svg = svg.replace(stand_in, f"var(--series-{n})")
    # Ids are unique within one drawing only, and the page holds several.
    svg = re.sub(r'id="([\w-]+)"', rf'id="{prefix}-\1"', svg)
    svg = re.sub(r"url\(#([\w-]+)\)", rf"url(#{prefix}-\1)", svg)
    # The page sets the size; the drawing keeps its proportions by its viewBox.
    return re.sub(r'(<svg [^>]*?) width="[\d.]+" height="[\d.]+"', r"\1", svg, count=1)


def summaries_by_class(results: Sequence[SolverResult]) -> list[tuple[str, list[tuple[str, Summary]]]]:
    """Numbers behind the figures: for each Bortle class, each solver's summary."""
    classes = list(dict.fromkeys(bortle for result in results for bortle, _ in result.bortle))
    return [
        (_label(bortle), [(r.solver, summary) for r in results for found, summary in r.bortle if found == bortle])
        for bortle in classes
    ]
