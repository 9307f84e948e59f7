"""Answers about the position: H4, H7, H9."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.stats.intervals import Estimate, proportion, quantile_estimate
from benchmark.stats.metrics import SUCCESS_KM
from benchmark.stats.paired_tests import mcnemar_exact
from benchmark.studies.common.page_model import Answer, Number, Outcome, Table, Verdict, family
from benchmark.studies.common.records import Rows
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.centroids import ATTITUDE_ERRORS_DEG, CHOICES, NOISE_PX, CentroidPart, TrueStarFix
from benchmark.studies.thesis.hypotheses import CLAIMS
from benchmark.studies.thesis.rendered import PART

CLAIMED_GAIN = (5.0, 20.0)


@dataclass(frozen=True)
class StarGain:
    """H4: error of one star over error of all stars, and the median error of one star, km."""

    ratio: Estimate
    one_star_km: Estimate


@dataclass(frozen=True)
class StarChoice:
    """A rule that chooses the star of a fix: share of fixes within 10 km, and the 90 % quantile of the error, km."""

    within_10_km: Estimate
    p90_km: float


@dataclass(frozen=True)
class StarChoices:
    """H7: rules that choose one star, and all stars without a rule."""

    central: StarChoice
    declination_limit: StarChoice
    determinant_limit: StarChoice
    determinant_weight: StarChoice
    all_stars: StarChoice


@dataclass(frozen=True)
class AttitudeEffect:
    """H9: median errors with the true attitude and with one that is off by a tenth of a degree, km.

    Attributes
    ----------
    noise_px : float
        Noise of the centroids.
    exact_km, tenth_km : Estimate
    factor : float
        Ratio of the medians; infinite where the smaller is zero.
    tenth_within_10_km : float
        Share of the fixes with the wrong attitude.
    """

    noise_px: float
    exact_km: Estimate
    tenth_km: Estimate
    factor: float
    tenth_within_10_km: float


def h4(rows: Rows) -> Answer:
    """One star against many."""
    many, one = rows.of(PART, who.ADAPTIVE), rows.of(PART, who.ADAPTIVE_ONE_STAR)
    both = many.identified & one.identified
    ratio = one.errors_km[both] / np.maximum(many.errors_km[both], 1e-6)
    gain = quantile_estimate(ratio, 0.5)
    low, high = CLAIMED_GAIN
    sure = low <= gain.low and gain.high <= high
    verdict = Verdict.YES if sure else Verdict.APPROXIMATELY if low <= gain.value <= high else Verdict.NO
    table = Table(
        "One star and all stars in the fix",
        f"rendered frames of all labels; ratio over {int(both.sum())} frames that both identify",
        ("", "median km", "recall"),
        (
            ("all confirmed stars", Number(many.median_km()), Number(many.recall(), "percent")),
            ("the reference star alone", Number(one.median_km()), Number(one.recall(), "percent")),
            ("error of one over error of all, median", Number(gain), "—"),
        ),
    )
    return Answer("H4", CLAIMS["H4"], (("", verdict),), StarGain(gain, one.median_km()), (table,))


def _errors(fixes: Sequence[TrueStarFix], experiment: str, setting: str) -> NDArray[np.float64]:
    chosen = sorted((f for f in fixes if (f.experiment, f.setting) == (experiment, setting)), key=lambda f: f.site)
    return np.array([f.error_km for f in chosen])


def _error_table(title: str, first: str, errors: dict[str, NDArray[np.float64]]) -> Table:
    n = len(next(iter(errors.values())))
    return Table(
        title,
        f"{n} centroid frames to magnitude 4, true names, {NOISE_PX:g} px of noise",
        (first, "median km", "90 % km", "error < 10 km"),
        tuple(
            (
                name,
                Number(quantile_estimate(found, 0.5)),
                Number(quantile_estimate(found, 0.9)),
                Number(proportion(found < SUCCESS_KM), "percent"),
            )
            for name, found in errors.items()
        ),
    )


def h7(part: CentroidPart) -> Answer:
    """Which star to use: by declination or by the determinant."""
    errors = {name: _errors(part.true_stars, "choice", name) for name in CHOICES}
    near = {name: found < SUCCESS_KM for name, found in errors.items()}
    central, by_dec, by_det, weighted, everything = CHOICES
    tests = family(
        [
            ("det J limit against |dec| limit", mcnemar_exact(near[by_det], near[by_dec])),
            ("largest det J of 10 against |dec| limit", mcnemar_exact(near[weighted], near[by_dec])),
            ("|dec| limit against no limit", mcnemar_exact(near[by_dec], near[central])),
            ("all stars against det J limit", mcnemar_exact(near[everything], near[by_det])),
        ]
    )

    verdicts = {Outcome.BETTER: Verdict.YES, Outcome.WORSE: Verdict.NO, Outcome.NO_DIFFERENCE: Verdict.NOT_SHOWN}
    choices = (StarChoice(proportion(near[name]), quantile_estimate(errors[name], 0.9).value) for name in CHOICES)
    return Answer(
        "H7",
        CLAIMS["H7"],
        (("as a limit", verdicts[tests[0].outcome]), ("as a weight", verdicts[tests[1].outcome])),
        StarChoices(*choices),
        (_error_table("Which star makes the fix", "star", errors),),
        tests,
    )


def h9(part: CentroidPart) -> Answer:
    """Effect of an attitude error."""
    errors = {f"{sigma:g} deg": _errors(part.true_stars, "attitude", f"{sigma:g}") for sigma in ATTITUDE_ERRORS_DEG}
    exact, tenth = (quantile_estimate(errors[name], 0.5) for name in ("0 deg", "0.1 deg"))
    return Answer(
        "H9",
        CLAIMS["H9"],
        (("", Verdict.YES if tenth.low > exact.high else Verdict.NOT_SHOWN),),
        AttitudeEffect(
            NOISE_PX,
            exact,
            tenth,
            tenth.value / exact.value if exact.value > 0 else math.inf,
            float(np.mean(errors["0.1 deg"] < SUCCESS_KM)),
        ),
        (_error_table("All stars, attitude in error", "attitude error about each axis", errors),),
    )
