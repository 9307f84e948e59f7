"""Numbers and the table of the cameras recovered by gradient."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from benchmark.report.formatting import number
from benchmark.studies.calibration.camera_by_gradient import Recovery
from benchmark.studies.common.page_model import Table

PARAMETERS = ("log f", "k1", "turn x", "turn y", "turn z")


@dataclass(frozen=True)
class GradientFinding:
    """How closely the recovered cameras approach their bound.

    Attributes
    ----------
    n_frames : int
    rms_over_bound : dict of str to float
        Root-mean-square error over the standard deviation of the bound, by parameter.
    nees, nees_low, nees_high : float
        Sum of the squared errors in the metric of the bound, and the range of 95 % of such sums where the bound is attained.
    steps : float
        Mean number of steps per frame.
    """

    n_frames: int
    rms_over_bound: dict[str, float]
    nees: float
    nees_low: float
    nees_high: float
    steps: float

    @property
    def worst_ratio(self) -> float:
        """The largest root-mean-square error over its bound."""
        return max(self.rms_over_bound.values())

    @property
    def inside(self) -> bool:
        """Whether the sum of the squared errors is in the range that the bound makes likely."""
        return self.nees_low <= self.nees <= self.nees_high


def gradient_finding(recovered: Sequence[Recovery]) -> GradientFinding:
    """Gather the numbers of the recovered cameras."""
    low, high = nees_interval(len(recovered))
    return GradientFinding(
        len(recovered),
        dict(zip(PARAMETERS, rms_over_bound(recovered), strict=True)),
        sum(one.nees for one in recovered),
        low,
        high,
        float(np.mean([one.steps for one in recovered])),
    )


def rms_over_bound(recovered: Sequence[Recovery]) -> list[float]:
    """Root mean square of each parameter's error over the standard deviation of the bound."""
    errors = np.array([one.error / one.sigma for one in recovered])
    return [float(value) for value in np.sqrt(np.mean(errors**2, axis=0))]


def nees_interval(n_frames: int) -> tuple[float, float]:
    """Range of 95 % of the summed squared errors if the bound is attained: chi^2 with five degrees of freedom per frame."""
    degrees = len(PARAMETERS) * n_frames
    return float(stats.chi2.ppf(0.025, degrees)), float(stats.chi2.ppf(0.975, degrees))


def gradient_table(recovered: Sequence[Recovery]) -> Table:
    """Errors of the recovered cameras next to their bound."""
    scale = np.array([1e6, 1e6, *[math.degrees(1) * 3600] * 3])
    units = ("millionths", "millionths", "arcsec", "arcsec", "arcsec")
    start, error, bound = (
        np.sqrt(np.mean([getattr(one, kind) ** 2 for one in recovered], axis=0)) * scale
        for kind in ("start", "error", "sigma")
    )
    ratios = rms_over_bound(recovered)
    body = tuple(
        (name, unit, number(a), number(b), number(c), f"{ratio:.2f}")
        for name, unit, a, b, c, ratio in zip(PARAMETERS, units, start, error, bound, ratios, strict=True)
    )
    n = len(recovered)
    low, high = (math.sqrt(float(stats.chi2.ppf(q, n)) / n) for q in (0.025, 0.975))
    return Table(
        "Recovered by gradient",
        f"{len(recovered)} rendered frames, each by itself; root mean squares",
        (
            "parameter",
            "unit",
            "error at the start",
            "error of the recovered camera",
            "Cramér-Rao bound",
            "error over bound",
        ),
        body,
        f"At the bound, the last column lies between {low:.2f} and {high:.2f} for 95 % of such sets.",
    )
