"""Figures of the calibration study."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from benchmark.studies.calibration import run as run
from benchmark.studies.calibration.camera_by_gradient import Recovery
from benchmark.studies.calibration.faults import Fault
from benchmark.studies.calibration.summary import Shifts
from benchmark.studies.common.series_plot import Axis, Series, plot

LEAST_KM, MOST_KM = 1e-3, 1e3
_KM = tuple((10.0**n, f"{10.0**n:g}") for n in range(-3, 4))
_SHAPES = {
    run.DECLARED: ("circle", True, -4.0),
    run.FOCAL: ("diamond", True, 8.0),
    run.CALIBRATED: ("circle", False, 4.0),
    run.VERTICAL: ("square", False, -8.0),
    run.THESIS_FIX: ("triangle", False, 0.0),
}
_SIZES = {"projection": "horizontal field", "refraction": "tilt of the camera", "k1": "k1 too large by"}
"""Name of a size, where the title of the fault is too long for an axis."""
_RMS_COLOUR = 1
_COLOURS = {name: place for place, name in enumerate(_SHAPES)}


def figure_fault(shifts: Shifts, fault: Fault) -> str:
    """Median shift against size, measured (marks) and predicted (lines)."""
    series = []
    for name, line in ((run.DECLARED, "solid"), (run.CALIBRATED, "dashed")):
        predicted = [shifts.of(run.CENTROIDS, fault.key, name, size).predicted_km() for size in fault.sizes]
        shown = [value if value >= LEAST_KM else math.nan for value in predicted]
        if any(math.isfinite(value) for value in shown):
            series.append(
                Series(
                    f"predicted: {name.removeprefix('camera ')}",
                    fault.sizes,
                    shown,
                    shape="none",
                    line=line,
                    colour=_COLOURS[name],
                )
            )
    for name, (shape, filled, shift) in _SHAPES.items():
        found = [shifts.of(run.CENTROIDS, fault.key, name, size).moved_km() for size in fault.sizes]
        values = [one.value if one.value >= LEAST_KM else math.nan for one in found]
        series.append(
            Series(
                name,
                fault.sizes,
                values,
                [e.low for e in found],
                [e.high for e in found],
                shape,
                filled,
                "none",
                shift,
                _COLOURS[name],
            )
        )
    floor = shifts.of(run.CENTROIDS, fault.key, run.DECLARED).faultless_km().value
    ends = _ends(fault)
    series.append(Series("error without the fault", ends, [floor, floor], shape="none", line="dotted"))
    what = _SIZES.get(fault.key, fault.title)
    title = f"{what}, {fault.unit}" if fault.unit else what
    x = Axis(title, *ends, tuple((size, f"{size:g}") for size in fault.sizes), log=fault.logarithmic)
    y = Axis("shift of the position, km", LEAST_KM, MOST_KM, _KM, log=True)
    return plot(series, x, y, f"Shift of the position against the size of the fault: {fault.title}")


def _ends(fault: Fault) -> tuple[float, float]:
    """Ends of the axis of sizes, slightly beyond them; a single size is centred."""
    low, high = min(fault.sizes), max(fault.sizes)
    if fault.logarithmic:
        margin = (high / low) ** 0.06 if high > low else 2.0
        return low / margin, high * margin
    margin = 0.06 * (high - low) or max(1.0, 0.1 * high)
    return low - margin, high + margin


def figure_paths(found: Sequence[Recovery]) -> str:
    """Distance between predicted and true stars at each step, one line per frame."""
    longest = max(len(one.path_px) for one in found)
    series = [
        Series("one frame a line", list(range(len(one.path_px))), one.path_px, shape="dot", line="solid")
        for one in found
    ]
    # One entry in the legend is enough.
    series = [series[0], *(Series("", s.x, s.y, shape="dot", line="solid") for s in series[1:])]
    x = Axis("step", -0.5, longest, tuple((float(t), str(t)) for t in range(0, longest + 1, 5)))
    ticks = tuple((10.0**n, f"{10.0**n:g}") for n in range(-4, 2))
    y = Axis("predicted to true star, rms, px", 1e-4, 20.0, ticks, log=True)
    return plot(series, x, y, "Convergence of the recovery by gradient")


def figure_errors(found: Sequence[Recovery], names: Sequence[str]) -> str:
    """Errors of the recovered parameters in standard deviations of the bound."""
    errors = np.array([one.error / one.sigma for one in found])
    spread = np.linspace(-0.25, 0.25, len(found))
    dots = Series(
        "one frame",
        [float(place + shift) for place in range(len(names)) for shift in spread],
        [float(value) for column in errors.T for value in column],
        line="none",
    )
    rms = np.sqrt(np.mean(errors**2, axis=0))
    series = [
        dots,
        Series(
            "root mean square",
            list(range(len(names))),
            list(rms),
            shape="diamond",
            filled=False,
            line="none",
            colour=_RMS_COLOUR,
        ),
    ]
    ends = (-0.5, len(names) - 0.5)
    for level, line in ((1.0, "dashed"), (3.0, "dotted")):
        series.append(Series(f"± {level:g} bound", ends, [level, level], shape="none", line=line))
        series.append(Series("", ends, [-level, -level], shape="none", line=line))
    x = Axis("parameter", *ends, tuple((float(place), name) for place, name in enumerate(names)))
    y = Axis("error over the bound's standard deviation", -4.0, 4.0, tuple((float(t), str(t)) for t in range(-4, 5)))
    return plot(series, x, y, "Errors of the camera recovered by gradient, over the Cramer-Rao bound")
