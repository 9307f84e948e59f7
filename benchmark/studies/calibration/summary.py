"""Numbers and tables of the calibration study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.report.formatting import number
from benchmark.stats.intervals import Estimate, proportion, quantile_estimate
from benchmark.studies.calibration import run as run
from benchmark.studies.calibration.faults import FAULTS, Fault
from benchmark.studies.calibration.run import Shift
from benchmark.studies.common.page_model import Cell, Number, Table

TAKEN_BACK, NOT_SEEN, MADE_WORSE, IN_PART = "taken back", "left as it is", "made worse", "in part"
NOISE_FACTOR = 3.0


@dataclass(frozen=True)
class Shifts:
    """Shifts that can be asked for."""

    rows: tuple[Shift, ...]

    def of(self, part: str, fault: str, contestant: str, size: float | None = None) -> Shifts:
        """Keep those of an experiment."""
        kept = (r for r in self.rows if (r.part, r.fault, r.contestant) == (part, fault, contestant))
        return Shifts(tuple(r for r in kept if size is None or r.size == size))

    def moved_km(self) -> Estimate:
        """Median length of the shift over all frames, refusals infinite."""
        return quantile_estimate(np.array([row.moved_km for row in self.rows]), 0.5)

    def predicted_km(self) -> float:
        """Median length of the prediction."""
        return float(np.median([row.predicted_km for row in self.rows])) if self.rows else math.nan

    def along(self) -> Estimate:
        """Median part of the prediction that the shift is, along it."""
        parts = np.array([row.along for row in self.rows])
        return quantile_estimate(parts[np.isfinite(parts)], 0.5)

    def fixed(self) -> Estimate:
        """Share of frames with a position in spite of the fault."""
        return proportion([math.isfinite(row.error_km) for row in self.rows])

    def error_km(self) -> Estimate:
        """Median error with the fault, refusals infinite."""
        return quantile_estimate(np.array([row.error_km for row in self.rows]), 0.5)

    def faultless_km(self) -> Estimate:
        """Median error without the fault."""
        return quantile_estimate(np.array([row.faultless_error_km for row in self.rows]), 0.5)


def verdict(believed: Shifts, calibrated: Shifts) -> str:
    """What self-calibration does to a fault, from the intervals of the medians.

    ``taken back``: less than a tenth is left, or clearly less than before and no more than three times the error without any
    fault. ``made worse``, ``in part``: the intervals do not overlap. ``left as it is``: they do.
    """
    before, after = believed.moved_km(), calibrated.moved_km()
    smaller = after.high < before.low
    if after.value < 0.1 * before.value or (smaller and after.value < NOISE_FACTOR * calibrated.faultless_km().value):
        return TAKEN_BACK
    if after.low > before.high:
        return MADE_WORSE
    return IN_PART if smaller else NOT_SEEN


def size_text(fault: Fault, size: float) -> str:
    """A size with its unit."""
    return f"{size:g} {fault.unit}".strip()


def summary_table(shifts: Shifts) -> Table:
    """One row a fault, at its typical size, on centroids."""
    body: list[tuple[Cell, ...]] = []
    for fault in FAULTS:
        believed, auto, full, vertical, thesis = (
            shifts.of(run.CENTROIDS, fault.key, name, fault.typical) for name in run.ON_CENTROIDS
        )
        body.append(
            (
                f"{fault.title} {size_text(fault, fault.typical)}",
                number(believed.predicted_km()),
                Number(believed.moved_km()),
                Number(believed.along()),
                Number(auto.moved_km()),
                Number(full.moved_km()),
                verdict(believed, full),
                Number(vertical.moved_km()),
                Number(thesis.moved_km()),
            )
        )
    n = len({row.site for row in shifts.rows if row.part == run.CENTROIDS})
    return Table(
        "What each fault does to a position, km",
        f"{n} centroid frames a row; shift of the position against the same frame without the fault",
        (
            "fault",
            "predicted",
            "camera believed",
            "shift over prediction",
            "focal length fitted if clearly off",
            "self-calibration",
            "by self-calibration",
            "vertical alone",
            "thesis' fix, true names",
        ),
        tuple(body),
        "Medians over frames with 95 % intervals. Predicted: median of the first-order prediction for the solver that "
        "believes its camera. Shift over prediction: the part of the shift along the prediction, over its length; 1 where "
        "first order is all there is. By self-calibration: what fitting focal length, principal point and two radial terms "
        "does to the shift; made worse, in part: the intervals do not overlap.",
    )


def size_tables(shifts: Shifts) -> tuple[Table, ...]:
    """One table a fault: all sizes, all solvers."""
    tables = []
    for fault in FAULTS:
        body: list[tuple[Cell, ...]] = []
        for size in fault.sizes:
            cells: list[Cell] = [size_text(fault, size)]
            for name in run.ON_CENTROIDS:
                found = shifts.of(run.CENTROIDS, fault.key, name, size)
                if name in (run.BELIEVED, run.CALIBRATED):
                    cells.append(number(found.predicted_km()))
                cells.append(Number(found.moved_km()))
            cells.append(Number(shifts.of(run.CENTROIDS, fault.key, run.BELIEVED, size).fixed(), "percent"))
            body.append(tuple(cells))
        tables.append(
            Table(
                fault.title,
                "median shift, km; ∞ where half of the frames or more are refused",
                ("size", *_headings(), "frames that still have a position, camera believed"),
                tuple(body),
            )
        )
    return tuple(tables)


def _headings() -> Iterable[str]:
    for name in run.ON_CENTROIDS:
        if name in (run.BELIEVED, run.CALIBRATED):
            yield f"{name}: predicted"
        yield name


def picture_table(shifts: Shifts) -> Table:
    """Rendered frames."""
    body: list[tuple[Cell, ...]] = []
    faults = [*(fault for fault in FAULTS if fault.key != "projection")]
    rows = [(fault.key, _picture_title(fault)) for fault in faults]
    rows.append(
        (run.THESIS_CASE, "The thesis' own case: a stereographic frame at the zenith told to be a 120 deg pinhole")
    )
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
        f"{n} rendered frames a row, detected by celnav; median shift, km",
        (
            "fault",
            "predicted",
            "shift over prediction",
            *run.ON_PICTURES,
            "fixed: camera believed",
            "fixed: self-calibration",
            "fixed: thesis-adaptive",
        ),
        tuple(body),
    )


def _picture_title(fault: Fault) -> str:
    if fault.key == "refraction":
        return "Refraction left out, 120 deg camera tilted by 20 deg"
    return f"{fault.title} {size_text(fault, fault.typical)}"


def sentences(shifts: Shifts) -> Sequence[str]:
    """The study's findings in sentences, from its numbers."""
    verdicts: dict[str, list[str]] = {}
    agreeing, n = [], 0
    for fault in FAULTS:
        believed = shifts.of(run.CENTROIDS, fault.key, run.BELIEVED, fault.typical)
        full = shifts.of(run.CENTROIDS, fault.key, run.CALIBRATED, fault.typical)
        name = f"{fault.title.lower()} {size_text(fault, fault.typical)}"
        verdicts.setdefault(verdict(believed, full), []).append(name)
        n += 1
        if 0.9 <= believed.along().value <= 1.1:
            agreeing.append(fault.key)
    parts = [
        f"Self-calibration takes back: {'; '.join(verdicts.get(TAKEN_BACK, ['nothing']))}.",
        f"It leaves as it is: {'; '.join(verdicts.get(NOT_SEEN, ['nothing']))}.",
    ]
    if verdicts.get(IN_PART):
        parts.append(f"In part: {'; '.join(verdicts[IN_PART])}.")
    if verdicts.get(MADE_WORSE):
        parts.append(
            f"It makes worse: {'; '.join(verdicts[MADE_WORSE])}. A camera that may bend follows what is not its own."
        )
    return (
        f"At its typical size the position moves within 10 % of the first-order prediction for {len(agreeing)} of {n} faults "
        f"({', '.join(agreeing)}).",
        " ".join(parts),
    )
