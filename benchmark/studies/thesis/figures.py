"""Figures of the replication."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from benchmark.stats.intervals import Estimate, wilson
from benchmark.studies.common.records import Rows
from benchmark.studies.common.series_plot import Axis, Series, plot
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis.answers_projection import swap_error_km
from benchmark.studies.thesis.centroids import CentroidPart
from benchmark.studies.thesis.rendered import PART

_COLOURS = {who.ADAPTIVE: 0, who.BASELINE: 1, who.BASELINE_SI: 2, who.LITERAL_ADAPTIVE: 3, who.LITERAL_BASELINE: 5}
_PERCENT = Axis("recall (error < 10 km)", 0.0, 1.0, tuple((n / 5, f"{20 * n} %") for n in range(6)))


def _labels() -> Axis:
    ticks = tuple((mag, f"{mag:g}\nB{place + 1}") for place, mag in enumerate(thesis.LABELS_MAG))
    return Axis("limiting magnitude of the set / the thesis' Bortle class", 8.25, 3.75, ticks)


def _series(
    name: str,
    x: Sequence[float],
    found: Sequence[Estimate],
    shape: str,
    filled: bool,
    line: str,
    shift: float,
    colour: int,
) -> Series:
    values, lows, highs = ([getattr(e, end) for e in found] for end in ("value", "low", "high"))
    return Series(name, x, values, lows, highs, shape, filled, line, shift, colour)


def _published(name: str, recalls: Sequence[float], shape: str, shift: float, colour: int) -> Series:
    ends = [wilson(r / 100 * thesis.N_FRAMES, thesis.N_FRAMES) for r in recalls]
    found = [Estimate(r / 100, low, high, thesis.N_FRAMES) for r, (low, high) in zip(recalls, ends, strict=True)]
    return _series(name, thesis.LABELS_MAG, found, shape, False, "dashed", shift, colour)


def figure_5(rows: Rows) -> str:
    """Recall by class, adaptive and baseline, the thesis' numbers and ours."""
    labels = sorted({row.depth_mag for row in rows.of(PART).rows}, reverse=True)
    series = [
        _published("thesis: adaptive", thesis.ADAPTIVE_RECALL, "circle", -9, _COLOURS[who.ADAPTIVE]),
        _published("thesis: baseline", thesis.BASELINE_RECALL, "square", -3, _COLOURS[who.BASELINE]),
    ]
    for name, shape, shift in ((who.ADAPTIVE, "circle", 3.0), (who.BASELINE, "square", 9.0)):
        found = [rows.of(PART, name, (label,)).recall() for label in labels]
        words = f"ours: {name.removeprefix('thesis-')}"
        series.append(_series(words, labels, found, shape, True, "solid", shift, _COLOURS[name]))
    found = [rows.of(PART, who.LITERAL_ADAPTIVE, (label,)).recall() for label in labels]
    colour = _COLOURS[who.LITERAL_ADAPTIVE]
    series.append(_series("to the letter: adaptive", labels, found, "triangle", True, "dotted", 0.0, colour))
    return plot(series, _labels(), _PERCENT, "Recall by limiting magnitude, the thesis and this study")


def figure_depth(rows: Rows, depths: Sequence[float]) -> str:
    """Recall of the literal reading against the depth of the frame."""
    axis = Axis(
        "faintest star in the frame, mag", max(depths) + 0.2, min(depths) - 0.2, tuple((d, f"{d:g}") for d in depths)
    )
    series = []
    for name, shape, line, shift in (
        (who.LITERAL_ADAPTIVE, "circle", "solid", -3.0),
        (who.LITERAL_BASELINE, "square", "dashed", 3.0),
        (who.ADAPTIVE, "triangle", "dotted", 6.0),
    ):
        found = [rows.of("centroids", name, (depth,)).recall() for depth in depths]
        series.append(_series(name, depths, found, shape, line == "solid", line, shift, _COLOURS[name]))
    return plot(series, axis, _PERCENT, "Recall by depth of the frame, centroids")


def figure_6(rows: Rows) -> str:
    """Time of solving by class."""
    labels = sorted({row.depth_mag for row in rows.of(PART).rows}, reverse=True)
    chosen = (
        (who.ADAPTIVE, "circle", True, "solid", -6.0),
        (who.BASELINE, "square", True, "solid", -2.0),
        (who.BASELINE_SI, "diamond", True, "dotted", 2.0),
        (who.LITERAL_ADAPTIVE, "circle", False, "dashed", 4.0),
        (who.LITERAL_BASELINE, "square", False, "dashed", 6.0),
    )
    series = []
    for name, shape, filled, line, shift in chosen:
        found = [rows.of(PART, name, (label,)).median_solve_ms() for label in labels]
        series.append(_series(name, labels, found, shape, filled, line, shift, _COLOURS[name]))
    highest = max(value for one in series for value in one.y if math.isfinite(value))
    top = 10.0 ** math.ceil(math.log10(max(highest * 2, 10.0)))
    ticks = [10.0**n for n in range(round(math.log10(top)) + 1)]
    axis = Axis("median time of solving, ms", 0.5, top, tuple((t, f"{t:g}") for t in ticks), log=True)
    return plot(series, _labels(), axis, "Median time of solving by limiting magnitude")


def figure_swap(part: CentroidPart) -> str:
    """One-star error against the angle off the axis, with and without the confusion of projections."""
    largest = max(12.0, *(f.off_axis_deg for f in part.one_star)) * 1.05
    curve = np.linspace(0.2, largest, 60)
    series = [Series("prediction of the mix-up", list(curve), list(swap_error_km(curve)), shape="none")]
    for projection, noise_px, filled in (("stereographic", 0.0, True), ("pinhole", 0.3, False)):
        fixes = [f for f in part.one_star if f.projection == projection and f.noise_px == noise_px]
        name = "mix-up, no noise" if noise_px == 0 else f"right projection, {noise_px:g} px"
        places, errors = [f.off_axis_deg for f in fixes], [f.error_km for f in fixes]
        series.append(Series(name, places, errors, shape="dot", filled=filled, line="none", colour=0 if filled else 1))
    x = Axis(
        "angle of the star off the axis, deg", 0.0, largest, tuple((t, f"{t}") for t in range(0, int(largest) + 1, 2))
    )
    y = Axis("error, km", 0.001, 1e4, tuple((10.0**n, f"{10.0**n:g}") for n in range(-3, 5)), log=True)
    return plot(series, x, y, "One-star error against the angle off the axis")
