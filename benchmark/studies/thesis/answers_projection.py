"""The answer about the projection: a stereographic frame solved as a pinhole's, H5."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.judge.geodesy import MEAN_RADIUS_KM
from benchmark.stats.intervals import Estimate, proportion, quantile_estimate
from benchmark.stats.metrics import SUCCESS_KM
from benchmark.studies.common.page_model import Answer, Cell, Comparison, Number, Outcome, Table, Verdict, family
from benchmark.studies.common.records import Rows, identified_test
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis.centroids import NOISE_PX, NOISES_PX, ONE_STAR_DEPTHS_MAG, CentroidPart
from benchmark.studies.thesis.hypotheses import CLAIMS

EXAMPLE_OFF_AXIS_DEG = 9.3
CENTROID_NOISE_KM = 0.1
"""Medians below this are caused by centroid noise, not by a wrong projection."""


@dataclass(frozen=True)
class ProjectionEffect:
    """H5: one-star errors with the right and the wrong projection, and identification with each.

    Attributes
    ----------
    example_deg, example_km : float
        Predicted error of a star at this angle from the axis.
    over_prediction : Estimate
        Error over prediction of one-star fixes with true names.
    dense_mag, sparse_mag, noise_px : float
        Depths of the frames from which the star is taken; noise of the centroids.
    wrong_dense_km, wrong_sparse_km : Estimate
        Median errors with the wrong projection, without noise.
    right_clean_km, right_noisy_km : Estimate
        With the right projection, to `dense_mag`, without and with noise.
    literal_identified_wrong, literal_identified_right : Estimate
        Shares of frames that the literal matcher identifies.
    """

    example_deg: float
    example_km: float
    over_prediction: Estimate
    dense_mag: float
    sparse_mag: float
    noise_px: float
    wrong_dense_km: Estimate
    wrong_sparse_km: Estimate
    right_clean_km: Estimate
    right_noisy_km: Estimate
    literal_identified_wrong: Estimate
    literal_identified_right: Estimate


def swap_error_km(off_axis_deg: ArrayLike) -> NDArray[np.float64]:
    """Error of a one-star fix when a stereographic frame is solved as that of a pinhole with the same focal length.

    A star theta off the axis is imaged at 2 f tan(theta/2) and taken for one at atan(2 tan(theta/2)). The zenith, and so the
    position, moves by the difference, about theta^3/4.

    Parameters
    ----------
    off_axis_deg : array_like
        True angle between star and axis, degrees.

    Returns
    -------
    ndarray
        km, on a sphere of the Earth's mean radius.
    """
    theta = np.radians(np.asarray(off_axis_deg, dtype=np.float64))
    return np.asarray(MEAN_RADIUS_KM * (theta - np.arctan(2 * np.tan(theta / 2))))


def h5(rows: Rows, part: CentroidPart) -> Answer:
    """Effect of the wrong projection on a fix from one star and on identification."""
    stars, medians = _one_star(part)
    swapped = [f for f in part.one_star if f.projection == "stereographic" and f.noise_px == 0.0]
    ratio = quantile_estimate([f.error_km / float(swap_error_km(f.off_axis_deg)) for f in swapped], 0.5)
    tests, patterns = _patterns(rows)
    dense, sparse = ONE_STAR_DEPTHS_MAG
    clean = medians["pinhole", dense, 0.0]
    wrong_dense, wrong_sparse = (medians["stereographic", depth, 0.0] for depth in ONE_STAR_DEPTHS_MAG)
    returns = any(m.low <= thesis.MEDIAN_KM <= m.high for m in (wrong_dense, wrong_sparse))
    lost = all(one.outcome is Outcome.BETTER for one in tests)
    literal = "literal adaptive, 60 deg"
    return Answer(
        "H5",
        CLAIMS["H5"],
        (
            ("right projection", Verdict.YES if clean.high < CENTROID_NOISE_KM else Verdict.NO),
            ("wrong projection", Verdict.POSSIBLE if returns else Verdict.NOT_SHOWN),
            ("patterns survive the wrong projection", Verdict.NO if lost else Verdict.NOT_SHOWN),
        ),
        ProjectionEffect(
            EXAMPLE_OFF_AXIS_DEG,
            float(swap_error_km(EXAMPLE_OFF_AXIS_DEG)),
            ratio,
            dense,
            sparse,
            NOISE_PX,
            wrong_dense,
            wrong_sparse,
            clean,
            medians["pinhole", dense, NOISE_PX],
            rows.of("projection stereographic", literal).id_recall(),
            rows.of("projection pinhole", literal).id_recall(),
        ),
        (stars, patterns),
        tests,
    )


def _one_star(part: CentroidPart) -> tuple[Table, dict[tuple[str, float, float], Estimate]]:
    """Table of the one-star fixes, and their median errors in km by projection, depth and noise."""
    body: list[tuple[Cell, ...]] = []
    medians: dict[tuple[str, float, float], Estimate] = {}
    for projection, depth, noise_px in itertools.product(("pinhole", "stereographic"), ONE_STAR_DEPTHS_MAG, NOISES_PX):
        chosen = [f for f in part.one_star if (f.projection, f.depth_mag, f.noise_px) == (projection, depth, noise_px)]
        errors = [f.error_km for f in chosen]
        medians[projection, depth, noise_px] = quantile_estimate(errors, 0.5)
        body.append(
            (
                f"{projection}, {noise_px:g} px, to mag {depth:g}",
                Number(quantile_estimate([f.off_axis_deg for f in chosen], 0.5)),
                Number(medians[projection, depth, noise_px]),
                Number(proportion([error < SUCCESS_KM for error in errors]), "percent"),
                str(len(errors)),
            )
        )
    table = Table(
        "The most central star, its name known",
        "centroid frames, solved as pinhole frames",
        ("frame made with, noise, stars", "median deg off the axis", "median km", "error < 10 km", "frames"),
        tuple(body),
    )
    return table, medians


def _patterns(rows: Rows) -> tuple[tuple[Comparison, ...], Table]:
    names = list(dict.fromkeys(row.contestant for row in rows.of("projection pinhole").rows))
    right = {name: rows.of("projection pinhole", name) for name in names}
    wrong = {name: rows.of("projection stereographic", name) for name in names}
    tests = family(
        [(f"{name}: right against wrong projection", identified_test(right[name], wrong[name])) for name in names]
    )
    table = Table(
        "Identification with the right and the wrong projection",
        f"{len(right[names[0]])} centroid frames each, to magnitude 3 and 4, {NOISE_PX:g} px of noise",
        ("variant", "right: identified", "right: < 10 km", "wrong: identified", "wrong: < 10 km"),
        tuple(
            (
                name,
                Number(right[name].id_recall(), "percent"),
                Number(right[name].recall(), "percent"),
                Number(wrong[name].id_recall(), "percent"),
                Number(wrong[name].recall(), "percent"),
            )
            for name in names
        ),
    )
    return tests, table
