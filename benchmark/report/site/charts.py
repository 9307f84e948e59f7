"""The site's figures. Each is small enough to be read at its natural size on a telephone."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from benchmark.report.formatting import interval, number, percent
from benchmark.report.site.boards import Level
from benchmark.report.site.panels import DASHED, DOTTED, Panel, colour_of
from benchmark.report.site.scales import Point, Scale, level_scale, log_scale, share_scale
from benchmark.report.site.tree import TaskFacts
from benchmark.stats.intervals import Estimate
from generator.drawing.palette import SOFT
from generator.drawing.style import LIGHT_PX, house_style

SHAPES = ("circle", "square", "triangle", "diamond")
# Size of one of many small panels, px.
SMALL_PX = (226, 128)
# Number of letters of a condition that fit under the axis of a small panel.
_AXIS_LETTERS = 40
_TITLE_LETTERS = 42
_SQUARE_PX = (150, 128)
_FOREST_PX, _NAMES_PX, _ROW_PX = 372, 168, 24
# Size of marks in a figure with all solvers, relative to those of a small panel.
_LARGE = 1.28


@dataclass(frozen=True)
class Style:
    """Appearance of one solver in every figure: number of its colour, shape of its points."""

    colour: int
    shape: str

    @property
    def css(self) -> str:
        """Class that sets the colour."""
        return f"f{self.colour}"


@dataclass(frozen=True)
class Mark:
    """One solver's number in a figure over solvers; `words` replace it where it is undefined."""

    name: str
    style: Style
    estimate: Estimate
    words: str = ""


Curves = Sequence[tuple[str, Style, Sequence[Level]]]


@house_style()
def success_curves(curves: Curves, task: TaskFacts, identity: str) -> tuple[Markup, list[Markup]]:
    """Success against the condition with its interval, one panel per solver, with all solvers in grey behind each.

    Parameters
    ----------
    curves : sequence of (name, Style, sequence of Level)
    task : TaskFacts
    identity : str
        Id of what the panels share, unique on the page.

    Returns
    -------
    backdrop, panels : Markup, list of Markup
        The backdrop must be placed on the page too.
    """
    x, y = condition_scale([levels for _, _, levels in curves], task), share_scale("")
    behind, panel = Panel(x, y, *SMALL_PX), Panel(x, y, *SMALL_PX, bare=True)
    behind.across(0.5)
    for _, _, levels in curves:
        behind.ghost([(level.condition, level.success.value) for level in levels])
    panels = []
    for name, style, levels in curves:
        _success(panel, style, levels)
        panels.append(panel.svg(_success_label(name, task), identity))
    return behind.backdrop(identity), panels


@house_style()
def success_curve(
    name: str, style: Style, levels: Sequence[Level], others: Sequence[Sequence[Level]], task: TaskFacts
) -> Markup:
    """One solver's success against the condition, with the best of the others at each value in grey behind."""
    panel = Panel(condition_scale([levels, *others], task), share_scale(""), *SMALL_PX)
    panel.across(0.5)
    best: dict[float, float] = {}
    for level in (level for other in others for level in other):
        best[level.condition] = max(level.success.value, best.get(level.condition, 0.0))
    panel.ghost(sorted(best.items()))
    _success(panel, style, levels)
    return panel.svg(_success_label(name, task))


def _success_label(name: str, task: TaskFacts) -> str:
    return f"Success of {name} by {task.axis}; the numbers are in the table of the task"


def _success(panel: Panel, style: Style, levels: Sequence[Level]) -> None:
    colour = colour_of(style.colour)
    panel.band(
        [(level.condition, level.success.low) for level in levels],
        [(level.condition, level.success.high) for level in levels],
        colour,
    )
    panel.line([(level.condition, level.success.value) for level in levels], colour)
    for level in levels:
        words = f"{level.condition:g}: {percent(level.success.value)} ({interval(level.success, percent)})"
        panel.dot((level.condition, level.success.value), colour, style.shape, words)


@house_style()
def error_curves(curves: Curves, task: TaskFacts, identity: str) -> tuple[Markup, list[Markup]]:
    """Median error against the condition with its interval and the Cramér-Rao bound (dashed); see `success_curves`."""
    x, y = condition_scale([levels for _, _, levels in curves], task), error_scale([levels for _, _, levels in curves])
    behind, panel = Panel(x, y, *SMALL_PX), Panel(x, y, *SMALL_PX, bare=True)
    for _, _, levels in curves:
        behind.ghost([(level.condition, level.median_error_km.value) for level in levels])
    if curves:
        bound = [(level.condition, level.bound_km) for level in curves[0][2]]
        behind.line(bound, SOFT.light, 1.5, dashes=DASHED)
    panels = []
    for name, style, levels in curves:
        _errors(panel, style, levels)
        label = f"Median error of {name} by {task.axis}; the numbers are in the table below"
        panels.append(panel.svg(label, identity))
    return behind.backdrop(identity), panels


def _errors(panel: Panel, style: Style, levels: Sequence[Level]) -> None:
    colour = colour_of(style.colour)
    panel.line([(level.condition, level.median_error_km.value) for level in levels], colour)
    bars = [
        ((level.condition, level.median_error_km.low), (level.condition, level.median_error_km.high))
        for level in levels
    ]
    # A bar over the whole axis only shows that there are too few frames; it stays in the background.
    bounded = [low[1] > 0.0 or math.isfinite(high[1]) for low, high in bars]
    panel.whiskers(list(itertools.compress(bars, bounded)), colour)
    panel.whiskers([bar for bar, known in zip(bars, bounded, strict=True) if not known], colour, alpha=0.2)
    for level in levels:
        error = level.median_error_km
        words = f"{level.condition:g}: {number(error.value, 'km')} ({interval(error, number)})"
        panel.dot((level.condition, error.value), colour, style.shape, words)


def error_scale(boards_levels: Sequence[Sequence[Level]]) -> Scale:
    """Axis of kilometres that contains all medians and bounds, with an extra step for medians that are refusals."""
    values = [level.median_error_km.value for levels in boards_levels for level in levels]
    values += [level.bound_km for levels in boards_levels for level in levels if not math.isnan(level.bound_km)]
    return log_scale(values, "km", refused=True)


@house_style()
def forest(marks: Sequence[Mark], x: Scale, label: str) -> Markup:
    """One row per solver: its number and interval."""
    rows = len(marks)
    y = Scale(lambda row: 1.0 - (row + 0.5) / rows, ())
    panel = Panel(x, y, _FOREST_PX - _NAMES_PX - 20, rows * _ROW_PX, left=_NAMES_PX)
    panel.uprights()
    for row, mark in enumerate(marks):
        estimate, colour = mark.estimate, colour_of(mark.style.colour)
        panel.row_text(row, _short(mark.name), -10.0, bold=True)
        if math.isnan(estimate.value):
            panel.row_text(row, mark.words, 8.0)
            continue
        panel.whiskers([((estimate.low, row), (estimate.high, row))], colour)
        words = f"{mark.name}: {number(estimate.value)} ({interval(estimate, number)})"
        panel.dot((estimate.value, row), colour, mark.style.shape, words, _LARGE)
    return panel.svg(label)


@house_style()
def pareto(points: Sequence[tuple[str, Style, Estimate, Estimate]], label: str) -> Markup:
    """Success against median time; the step joins the solvers that no other beats in both. Names are at the right.

    Parameters
    ----------
    points : sequence of (name, style, time in ms, success)
    label : str
    """
    x = log_scale([end for _, _, time, _ in points for end in (time.value, time.low, time.high)], "median time, ms")
    panel = Panel(x, share_scale(""), 166, 210, right=154)
    front = _front([(time.value, success.value) for _, _, time, success in points])
    panel.steps([*front, (x.ticks[-1][0], front[-1][1])] if front else [])
    for name, style, time, success in points:
        colour = colour_of(style.colour)
        bars = [
            ((time.value, success.low), (time.value, success.high)),
            ((time.low, success.value), (time.high, success.value)),
        ]
        panel.whiskers(bars, colour, LIGHT_PX)
        words = f"{name}: {percent(success.value)} in {number(time.value, 'ms')}"
        panel.dot((time.value, success.value), colour, style.shape, words, _LARGE)
    for place, (name, _, time, success) in zip(
        _apart([success.value for _, _, _, success in points], 15.0 / panel.height), points, strict=True
    ):
        panel.margin_text((time.value, success.value), place, _short(name))
    return panel.svg(label)


@house_style()
def reliabilities(
    solvers: Sequence[tuple[str, Style, Sequence[tuple[float, Estimate]]]], identity: str
) -> tuple[Markup, list[Markup]]:
    """Share of correct answers against the claimed confidence; on the diagonal the claim is true. See `success_curves`."""
    x, y = share_scale("confidence claimed", 0.5), share_scale("", 0.5)
    behind, panel = Panel(x, y, *_SQUARE_PX), Panel(x, y, *_SQUARE_PX, bare=True)
    behind.line([(0.0, 0.0), (1.0, 1.0)], SOFT.light, LIGHT_PX, dashes=DOTTED)
    panels = []
    for name, style, bins in solvers:
        colour = colour_of(style.colour)
        panel.line([(confidence, share.value) for confidence, share in bins], colour)
        panel.whiskers([((confidence, share.low), (confidence, share.high)) for confidence, share in bins], colour)
        for confidence, share in bins:
            words = f"claimed {percent(confidence)}: right in {percent(share.value)} of {share.n}"
            panel.dot((confidence, share.value), colour, style.shape, words)
        label = f"Reliability of the confidence of {name}; the numbers are in the table below"
        panels.append(panel.svg(label, identity))
    return behind.backdrop(identity), panels


@house_style()
def risk_coverages(
    solvers: Sequence[tuple[str, Style, Sequence[Point], float]], identity: str
) -> tuple[Markup, list[Markup]]:
    """Share of wrong answers among those kept, against the share kept, most confident first. See `success_curves`.

    Parameters
    ----------
    solvers : sequence of (name, style, points, answered)
        `answered` is the share of frames with a fix; the curve beyond it is dotted.
    identity : str
    """
    x, y = share_scale("frames answered", 0.5), share_scale("", 0.5)
    behind, panel = Panel(x, y, *_SQUARE_PX), Panel(x, y, *_SQUARE_PX, bare=True)
    panels = []
    for name, style, points, answered in solvers:
        behind.ghost(points)
        colour = colour_of(style.colour)
        panel.line([point for point in points if point[0] <= answered], colour)
        panel.line([point for point in points if point[0] >= answered], colour, dashes=DOTTED)
        label = f"Share of wrong answers of {name} against frames answered; its area is in the table above"
        panels.append(panel.svg(label, identity))
    return behind.backdrop(identity), panels


def condition_scale(curves: Sequence[Sequence[Level]], task: TaskFacts) -> Scale:
    """Axis of a task's condition, harder to the right; its title is cut to what a small panel can hold."""
    levels = sorted({level.condition for curve in curves for level in curve})
    unit = f", {task.unit}" if task.unit else ""
    words = _short(task.condition, min(_AXIS_LETTERS, _TITLE_LETTERS - len(unit)))
    scale = level_scale(levels, words + unit)
    if task.harder > 0:
        return scale
    return Scale(lambda value: 1.0 - scale.place(value), scale.ticks, scale.title)


def _front(points: Sequence[Point]) -> list[Point]:
    """Points that no other beats in both time and success, by time."""
    front: list[Point] = []
    for time, success in sorted(points, key=lambda point: (point[0], -point[1])):
        if not math.isnan(success) and (not front or success > front[-1][1]):
            front.append((time, success))
    return front


def _apart(places: Sequence[float], gap: float) -> list[float]:
    """Move positions 0 to 1 as little as a sweep from below and one from above need to keep them `gap` apart."""
    order = sorted(range(len(places)), key=lambda n: places[n])
    moved = [min(max(place, 0.0), 1.0) for place in places]
    for before, after in itertools.pairwise(order):
        moved[after] = max(moved[after], moved[before] + gap)
    ceiling = 1.0
    for n in reversed(order):
        moved[n] = min(moved[n], ceiling)
        ceiling = moved[n] - gap
    return moved


def _short(name: str, most: int = 22) -> str:
    return name if len(name) <= most else name[: most - 1] + "…"
