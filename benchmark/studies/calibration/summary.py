"""Numbers and tables of the calibration study."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from benchmark.report.formatting import number
from benchmark.stats.intervals import Estimate, proportion, quantile_estimate
from benchmark.stats.metrics import SUCCESS_KM
from benchmark.studies.calibration import run as run
from benchmark.studies.calibration.faults import FAULTS, Fault
from benchmark.studies.calibration.run import Shift
from benchmark.studies.common.page_model import Cell, Number, Table

NOISE_FACTOR = 3.0
AS_PREDICTED = 0.1


class Effect(StrEnum):
    """Effect of self-calibration on the shift of a position."""

    CORRECTED = "corrected"
    PARTLY_CORRECTED = "partly corrected"
    UNCHANGED = "unchanged"
    WORSE = "worse"


@dataclass(frozen=True)
class Shifts:
    """Shifts with selections, and the faults that caused them."""

    rows: tuple[Shift, ...]
    faults: tuple[Fault, ...] = FAULTS

    def of(self, part: str, fault: str, contestant: str, size: float | None = None) -> Shifts:
        """Select the shifts of an experiment."""
        kept = (r for r in self.rows if (r.part, r.fault, r.contestant) == (part, fault, contestant))
        return Shifts(tuple(r for r in kept if size is None or r.size == size), self.faults)

    def moved_km(self) -> Estimate:
        """Median length of the shift over all frames, with refusals as infinite."""
        return quantile_estimate(np.array([row.moved_km for row in self.rows]), 0.5)

    def predicted_km(self) -> float:
        """Median length of the prediction."""
        return float(np.median([row.predicted_km for row in self.rows])) if self.rows else math.nan

    def along(self) -> Estimate:
        """Median ratio of the shift's component along the prediction to the prediction."""
        parts = np.array([row.along for row in self.rows])
        return quantile_estimate(parts[np.isfinite(parts)], 0.5)

    def fixed(self) -> Estimate:
        """Share of frames with a position in spite of the fault."""
        return proportion([math.isfinite(row.error_km) for row in self.rows])

    def error_km(self) -> Estimate:
        """Median error with the fault, with refusals as infinite."""
        return quantile_estimate(np.array([row.error_km for row in self.rows]), 0.5)

    def faultless_km(self) -> Estimate:
        """Median error without the fault."""
        return quantile_estimate(np.array([row.faultless_error_km for row in self.rows]), 0.5)


def effect_of_calibration(declared: Shifts, calibrated: Shifts) -> Effect:
    """Effect of self-calibration on a fault, from the medians of the shift without and with it.

    A fault counts as corrected if less than a tenth of the shift remains, or if the shift is clearly smaller than before and
    no more than three times the error without any fault. Otherwise the intervals of the medians decide.
    """
    before, after = declared.moved_km(), calibrated.moved_km()
    smaller = after.high < before.low
    if after.value < 0.1 * before.value or (smaller and after.value < NOISE_FACTOR * calibrated.faultless_km().value):
        return Effect.CORRECTED
    if after.low > before.high:
        return Effect.WORSE
    return Effect.PARTLY_CORRECTED if smaller else Effect.UNCHANGED


def size_text(fault: Fault, size: float) -> str:
    """Format a size with its unit."""
    return f"{size:g} {fault.unit}".strip()


def fault_text(fault: Fault, size: float) -> str:
    """Format a fault with its size: ``focal length too long (0.3 %)``."""
    return f"{fault.title} ({size_text(fault, size)})"


def summary_table(shifts: Shifts) -> Table:
    """One row per fault, at its typical size, on centroids."""
    body: list[tuple[Cell, ...]] = []
    for fault in shifts.faults:
        declared, auto, full, vertical, thesis = (
            shifts.of(run.CENTROIDS, fault.key, name, fault.typical) for name in run.ON_CENTROIDS
        )
        body.append(
            (
                fault_text(fault, fault.typical),
                number(declared.predicted_km()),
                Number(declared.moved_km()),
                Number(declared.along()),
                Number(auto.moved_km()),
                Number(full.moved_km()),
                str(effect_of_calibration(declared, full)),
                Number(vertical.moved_km()),
                Number(thesis.moved_km()),
            )
        )
    n = len({row.site for row in shifts.rows if row.part == run.CENTROIDS})
    return Table(
        "Shift of the position by each fault, km",
        f"{n} centroid frames a row; shift of the position against the same frame without the fault",
        (
            "fault",
            "predicted",
            run.DECLARED,
            "shift over prediction",
            run.FOCAL,
            "self-calibration",
            "effect of self-calibration",
            "vertical alone",
            "thesis' fix, true names",
        ),
        tuple(body),
        "Medians over frames with 95 % intervals. Predicted: median of the first-order prediction without calibration. "
        "Shift over prediction: the component of the shift along the prediction, over the prediction's length; 1 where the "
        "first order is exact. Effect of self-calibration: what fitting focal length, principal point and two radial terms "
        "does to the shift; for worse and partly corrected the intervals do not overlap.",
    )


def size_tables(shifts: Shifts) -> tuple[Table, ...]:
    """One table per fault: all sizes, all solvers."""
    tables = []
    for fault in shifts.faults:
        body: list[tuple[Cell, ...]] = []
        for size in fault.sizes:
            cells: list[Cell] = [size_text(fault, size)]
            for name in run.ON_CENTROIDS:
                found = shifts.of(run.CENTROIDS, fault.key, name, size)
                if name in (run.DECLARED, run.CALIBRATED):
                    cells.append(number(found.predicted_km()))
                cells.append(Number(found.moved_km()))
            cells.append(Number(shifts.of(run.CENTROIDS, fault.key, run.DECLARED, size).fixed(), "percent"))
            body.append(tuple(cells))
        tables.append(
            Table(
                fault.title,
                "median shift, km; ∞ where half of the frames or more are refused",
                ("size", *_headings(), f"frames that still have a position, {run.DECLARED}"),
                tuple(body),
            )
        )
    return tuple(tables)


def _headings() -> Iterable[str]:
    for name in run.ON_CENTROIDS:
        if name in (run.DECLARED, run.CALIBRATED):
            yield f"{name}: predicted"
        yield name


def picture_table(shifts: Shifts, camera: str) -> Table:
    """Table for rendered frames of a camera, which is given in words."""
    body: list[tuple[Cell, ...]] = []
    rows = [(fault.key, _picture_title(fault)) for fault in shifts.faults if fault.key != "projection"]
    thesis = f"a stereographic frame at the zenith declared as a {run.THESIS_FIELD_DEG:g} deg pinhole"
    rows.append((run.THESIS_CASE, f"The thesis' own case: {thesis}"))
    for key, title in rows:
        found = [shifts.of(run.PICTURES, key, name) for name in run.ON_PICTURES]
        cells: list[Cell] = [title, number(found[0].predicted_km()), Number(found[0].along())]
        cells += [Number(one.moved_km()) for one in found]
        cells += [
            Number(found[0].fixed(), "percent"),
            Number(found[2].fixed(), "percent"),
            Number(found[4].fixed(), "percent"),
        ]
        body.append(tuple(cells))
    n = len({row.site for row in shifts.rows if row.part == run.PICTURES})
    return Table(
        "Rendered frames",
        f"{n} rendered frames a row ({camera}), detected by celnav; median shift, km",
        (
            "fault",
            "predicted",
            "shift over prediction",
            *run.ON_PICTURES,
            f"fixed: {run.DECLARED}",
            f"fixed: {run.CALIBRATED}",
            f"fixed: {run.THESIS}",
        ),
        tuple(body),
    )


def _picture_title(fault: Fault) -> str:
    if fault.key == "refraction":
        return "Refraction neglected (the camera as it points)"
    return fault_text(fault, fault.typical)


@dataclass(frozen=True)
class FaultFindings:
    """Findings about faults at their typical sizes.

    Attributes
    ----------
    n_faults : int
    as_predicted : tuple of str
        Faults whose median shift is within 10 % of the first-order prediction.
    by_effect : dict of Effect to tuple of str
        Faults with their sizes, by the effect of self-calibration on their shift.
    """

    n_faults: int
    as_predicted: tuple[str, ...]
    by_effect: dict[Effect, tuple[str, ...]]


@dataclass(frozen=True)
class ThesisCase:
    """The case of the thesis: stereographic pictures declared as a pinhole's.

    Attributes
    ----------
    n_pictures : int
    fixed : dict of str to int
        Number of pictures with a position, by solver.
    most_near : int
        Largest number of them within 10 km for any solver.
    """

    n_pictures: int
    fixed: dict[str, int]
    most_near: int


def fault_findings(shifts: Shifts) -> FaultFindings:
    """Classify the faults by their agreement with the prediction and by the effect of self-calibration."""
    by_effect: dict[Effect, list[str]] = {effect: [] for effect in Effect}
    as_predicted = []
    for fault in shifts.faults:
        declared = shifts.of(run.CENTROIDS, fault.key, run.DECLARED, fault.typical)
        full = shifts.of(run.CENTROIDS, fault.key, run.CALIBRATED, fault.typical)
        by_effect[effect_of_calibration(declared, full)].append(fault_text(fault, fault.typical))
        if abs(declared.along().value - 1.0) <= AS_PREDICTED:
            as_predicted.append(fault.title)
    return FaultFindings(
        len(shifts.faults), tuple(as_predicted), {effect: tuple(names) for effect, names in by_effect.items()}
    )


def thesis_case(shifts: Shifts) -> ThesisCase:
    """Count the positions of the thesis' own case."""
    case = {
        name: shifts.of(run.PICTURES, run.THESIS_CASE, name).rows for name in (run.DECLARED, run.CALIBRATED, run.THESIS)
    }
    return ThesisCase(
        max(len(rows) for rows in case.values()),
        {name: sum(math.isfinite(row.error_km) for row in rows) for name, rows in case.items()},
        max(sum(row.error_km < SUCCESS_KM for row in rows) for rows in case.values()),
    )
