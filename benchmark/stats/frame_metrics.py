"""Metrics of one solver as functions of its table of frames (docs/benchmark.md gives definitions and sources).

A table is a pandas data frame with the columns of ``frames.parquet``. Frames without a fix have an infinite error, so
refusing never improves a quantile. Every rate is a share of all frames unless its definition states otherwise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmark.errors import ResultsError
from benchmark.stats.clustered import Resamples, mean_estimate, proportion_estimate, quantile_estimate
from benchmark.stats.intervals import Estimate
from benchmark.stats.metrics import FIX, SUCCESS_KM
from benchmark.stats.within_conditions import share_within_conditions
from generator.errors import GeneratorError
from generator.reading.table import check_claims

F8 = NDArray[np.float64]
Bools = NDArray[np.bool_]

SUCCESS_KEY = re.compile(r"success_(\d+(?:\.\d+)?(?:e[+-]\d+)?)km")
SUCCESS_LEVELS_KM = (1.0, 3.0, 10.0, 30.0)
UNDEFINED = Estimate(math.nan, math.nan, math.nan, 0)
KELVINS_PENALTY = 2.0


@dataclass(frozen=True)
class Metric:
    """A number that is computed from a table of frames.

    Attributes
    ----------
    key : str
        Its name in files.
    heading : str
        Its name for readers.
    unit : str
        Empty for proportions and scores.
    better : int
        1 where larger values are better, -1 where smaller ones are, 0 where neither.
    measure : callable
        Takes the table and the resamples of its clusters.
    """

    key: str
    heading: str
    unit: str
    better: int
    measure: Callable[[pd.DataFrame, Resamples], Estimate]


def read_frames(path: Path) -> pd.DataFrame:
    """Read ``frames.parquet`` without the solver's own timing of its stages.

    Raises
    ------
    ResultsError
    """
    try:
        check_claims(path)
        columns = [name for name in pq.read_schema(path).names if name != "stage_ms"]
        table: pd.DataFrame = pq.read_table(path, columns=columns).to_pandas()
    except (GeneratorError, pa.ArrowException, OSError) as error:
        raise ResultsError(f"{path}: missing or damaged ({error}); run `skybench bench run` again") from error
    return table


def sites(frames: pd.DataFrame) -> NDArray[np.str_]:
    """Cluster of each frame; a frame without a site forms its own cluster."""
    if "site" not in frames:
        return np.asarray(frames["frame_id"], dtype=str)
    site = frames["site"].fillna("").astype(str).to_numpy(dtype=str)
    return np.where(site == "", "frame " + frames["frame_id"].astype(str).to_numpy(dtype=str), site)


def resamples_of(frames: pd.DataFrame) -> Resamples:
    """Resamples of the table's sites."""
    return Resamples.of(sites(frames))


def column(frames: pd.DataFrame, name: str) -> F8:
    """A numeric column, NaN where the table has none or the cell is empty; shape (n,)."""
    if name not in frames:
        return np.full(len(frames), math.nan)
    return frames[name].to_numpy(dtype=np.float64, na_value=math.nan)


def fixed(frames: pd.DataFrame) -> Bools:
    """Which frames have a fix."""
    return np.asarray(frames["status"].to_numpy() == FIX)


def errors_km(frames: pd.DataFrame) -> F8:
    """Error of each frame, +inf without a fix."""
    error = column(frames, "error_km")
    return np.where(fixed(frames) & ~np.isnan(error), error, math.inf)


def succeeded(frames: pd.DataFrame, limit_km: float = SUCCESS_KM) -> Bools:
    """Which frames have a fix and an error below the limit."""
    return np.asarray(errors_km(frames) < limit_km)


def identified(frames: pd.DataFrame, limit_km: float = SUCCESS_KM) -> Bools:
    """Which frames have a fix from the right stars: most stars that it names are right, or its error is within the limit.

    Accuracy and calibration of a solver are measured on these fixes. If only fixes within the limit counted, large errors
    would be excluded because they are large, and errors would look smaller than they are; the closer the limit is to the
    error that the supplied vertical causes, the stronger the effect. A fix may be within the limit and name no star: some
    solvers return no identifications, and for some photographs they are unknown.
    """
    return np.asarray(succeeded(frames, limit_km) | named_right(frames))


def named_right(frames: pd.DataFrame) -> Bools:
    """Which frames have a fix of whose named stars most are right."""
    return np.asarray(fixed(frames) & (2.0 * column(frames, "n_correct") > column(frames, "n_matches")))


def success(frames: pd.DataFrame, resamples: Resamples, limit_km: float = SUCCESS_KM) -> Estimate:
    """Share of all frames with a fix and an error below the limit."""
    return share_within_conditions(succeeded(frames, limit_km), column(frames, "condition"), resamples)


def wrong_and_confident(frames: pd.DataFrame, resamples: Resamples, limit_km: float = SUCCESS_KM) -> Estimate:
    """Share of all frames with a fix whose error reaches or exceeds the limit of success."""
    wrong = fixed(frames) & ~succeeded(frames, limit_km)
    return share_within_conditions(wrong, column(frames, "condition"), resamples)


def error_quantile(frames: pd.DataFrame, resamples: Resamples, q: float) -> Estimate:
    """Quantile of the error over all frames."""
    return quantile_estimate(errors_km(frames), q, resamples)


def star_precision(frames: pd.DataFrame, resamples: Resamples) -> Estimate:
    """Share of correct matches among all claimed matches."""
    return proportion_estimate(frames["n_correct"], frames["n_matches"], resamples)


def names_no_star(frames: pd.DataFrame) -> bool:
    """Whether a solver has fixes but returns no matches, so that none of them says which stars it saw."""
    return bool(fixed(frames).any()) and not column(frames, "n_matches").any()


def share_named_right(frames: pd.DataFrame, resamples: Resamples) -> Estimate:
    """Share of all frames that are `named_right`; undefined for a solver that returns no matches."""
    if names_no_star(frames):
        return UNDEFINED
    return share_within_conditions(named_right(frames), column(frames, "condition"), resamples)


def star_recall(frames: pd.DataFrame, resamples: Resamples) -> Estimate:
    """Share of all detections of a star that are matched correctly; undefined for a solver that returns no matches."""
    if names_no_star(frames):
        return UNDEFINED
    return proportion_estimate(frames["n_correct"], frames["n_detected_stars"], resamples)


def kelvins_scores(frames: pd.DataFrame) -> F8:
    """Score of each frame, max((correct - 2 wrong) / max(stars, 1), -1), shape (n,).

    References
    ----------
    ESA Advanced Concepts Team, "Star Trackers: First Contact", Kelvins competition, 2016, page "Evaluation"
    (live.kelvins.esa.int/star-trackers-first-contact/evaluation).
    """
    correct = column(frames, "n_correct")
    wrong = column(frames, "n_matches") - correct
    stars = np.maximum(column(frames, "n_detected_stars"), 1.0)
    return np.asarray(np.maximum((correct - KELVINS_PENALTY * wrong) / stars, -1.0))


def kelvins(frames: pd.DataFrame, resamples: Resamples) -> Estimate:
    """Mean of the frames' scores; undefined for a solver that returns no matches."""
    if names_no_star(frames):
        return UNDEFINED
    return mean_estimate(kelvins_scores(frames), resamples, (-1.0, 1.0))


def bound_ratios(frames: pd.DataFrame) -> F8:
    """Ratio of the error to the root of the trace of a frame's Cramér-Rao bound; +inf without a fix, NaN without a bound."""
    bound = column(frames, "crlb_km")
    usable = np.isfinite(bound) & (bound > 0)
    return np.where(usable, errors_km(frames) / np.where(usable, bound, 1.0), math.nan)


def bound_ratio(frames: pd.DataFrame, resamples: Resamples) -> Estimate:
    """Median of `bound_ratios` over all frames that have a bound.

    An estimator that attains the bound has 0.67 (all of the error in one direction) to 0.83 (a round error ellipse).
    """
    return quantile_estimate(bound_ratios(frames), 0.5, resamples)


def bound_ratio_of_identified(frames: pd.DataFrame, resamples: Resamples, limit_km: float = SUCCESS_KM) -> Estimate:
    """Median of `bound_ratios` over the `identified` fixes: the accuracy of a solver where it knows the stars."""
    return quantile_estimate(np.where(identified(frames, limit_km), bound_ratios(frames), math.nan), 0.5, resamples)


def time_quantile(frames: pd.DataFrame, resamples: Resamples, q: float) -> Estimate:
    """Quantile of the time per frame, refused frames included."""
    return quantile_estimate(column(frames, "time_ms"), q, resamples)


def peak_memory(frames: pd.DataFrame, resamples: Resamples) -> Estimate:
    """Largest memory over all frames; a maximum has no interval."""
    memory = column(frames, "peak_memory_mib")
    known = memory[~np.isnan(memory)]
    return Estimate(float(known.max()), math.nan, math.nan, len(known)) if len(known) else UNDEFINED


def success_limit_km(key: str) -> float:
    """Limit that the key of a success metric states. Raises ResultsError for any other key."""
    found = SUCCESS_KEY.fullmatch(key)
    if found is None:
        raise ResultsError(f"metric {key!r} is not success_Nkm with a number N")
    return float(found[1])


def success_metric(key: str) -> Metric:
    """Metric that belongs to a key such as ``success_10km``. Raises ResultsError for any other key."""
    return _success_at(success_limit_km(key), key)


def _success_at(limit_km: float, key: str = "") -> Metric:
    return Metric(
        key or f"success_{limit_km:g}km",
        f"success, {limit_km:g} km",
        "",
        1,
        lambda frames, resamples: success(frames, resamples, limit_km),
    )


def metrics_within(limit_km: float) -> tuple[Metric, ...]:
    """All metrics of a table; fixes count as right within the given limit, that of their task."""
    return (
        *(_success_at(limit) for limit in SUCCESS_LEVELS_KM),
        Metric("median_error_km", "median error", "km", -1, lambda f, r: error_quantile(f, r, 0.5)),
        Metric("p90_error_km", "90 % error", "km", -1, lambda f, r: error_quantile(f, r, 0.9)),
        Metric("wrong_and_confident", "wrong and confident", "", -1, lambda f, r: wrong_and_confident(f, r, limit_km)),
        Metric("stars_named_right", "stars named right", "", 1, share_named_right),
        Metric("star_precision", "star-ID precision", "", 1, star_precision),
        Metric("star_recall", "star-ID recall", "", 1, star_recall),
        Metric("kelvins_score", "Kelvins score", "", 1, kelvins),
        Metric("bound_ratio", "error / Cramér-Rao bound", "", -1, bound_ratio),
        Metric(
            "identified_bound_ratio",
            "error / Cramér-Rao bound of identified fixes",
            "",
            -1,
            lambda f, r: bound_ratio_of_identified(f, r, limit_km),
        ),
        Metric("median_time_ms", "median time", "ms", -1, lambda f, r: time_quantile(f, r, 0.5)),
        Metric("p95_time_ms", "95 % time", "ms", -1, lambda f, r: time_quantile(f, r, 0.95)),
        Metric("peak_memory_mib", "peak memory", "MiB", -1, peak_memory),
    )


METRICS = metrics_within(SUCCESS_KM)


def measure(frames: pd.DataFrame, metrics: Iterable[Metric] = METRICS) -> dict[str, Estimate]:
    """Compute metrics of a table, by key; undefined ones (nothing to count) are NaN."""
    if len(frames) == 0:
        return {metric.key: UNDEFINED for metric in metrics}
    resamples = resamples_of(frames)
    return {metric.key: metric.measure(frames, resamples) for metric in metrics}


def groups_of(values: F8, max_groups: int) -> list[Bools]:
    """Masks of the frames with each distinct value, or of each of `max_groups` groups of similar size; NaN is in no group."""
    known = values[~np.isnan(values)]
    distinct = np.unique(known)
    if len(distinct) <= max_groups:
        return [values == value for value in distinct]
    edges = np.unique(np.quantile(known, np.arange(1, max_groups) / max_groups, method="higher"))
    place = np.searchsorted(edges, values, side="right")
    return [mask for i in range(len(edges) + 1) if (mask := (place == i) & ~np.isnan(values)).any()]
