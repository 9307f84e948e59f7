"""Scores of frames and their summaries; docs/benchmark.md defines each metric in words."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from benchmark.stats.clustered import Resamples, proportion_estimate, quantile_estimate
from benchmark.stats.intervals import Estimate
from benchmark.stats.within_conditions import share_within_conditions

SUCCESS_KM = 10.0
"""Limit of success where no task states its own."""
DEFINITIONS = "skybench-metrics/2"

FIX = "fix"
REFUSED = "refused"
ERROR = "error"


@dataclass(frozen=True)
class FrameScore:
    """Judged result of one solver on one frame.

    Attributes
    ----------
    frame_id, index
        Those of the frame.
    bortle : int or None
        The frame's Bortle class.
    width_px, height_px : int
        Size of the image.
    status : str
        ``fix``, ``refused``, or ``error`` (the solver raised or gave an invalid answer; scored as a refusal).
    reason : str
        Empty with a fix.
    lat_deg, lon_deg : float or None
        The claimed position, None without a fix.
    error_km : float
        Geodesic distance to the truth; +inf without a fix.
    n_detections, n_detected_stars, n_matches, n_correct : int
        Star identification, see `benchmark.judge.star_id`.
    time_ms : float
        Wall-clock time of detection and solving together.
    site : str
        Frames of one site are not independent (`benchmark.frames.sites`); empty for a frame that forms its own site.
    condition : float or None
        What the frame's task is graded by; None for a frame of no such task.
    """

    frame_id: str
    index: int
    bortle: int | None
    width_px: int
    height_px: int
    status: str
    reason: str
    lat_deg: float | None
    lon_deg: float | None
    error_km: float
    n_detections: int
    n_detected_stars: int
    n_matches: int
    n_correct: int
    time_ms: float
    site: str = ""
    condition: float | None = None


@dataclass(frozen=True)
class Summary:
    """Metrics over a set of frames, with intervals that treat the frames of a site as one cluster.

    Shares of all frames have the variance within the task's conditions (`benchmark.stats.within_conditions`).

    Attributes
    ----------
    n_frames, n_fixes, n_refused, n_errors : int
        Counts; the last three add up to the first.
    recall : Estimate
        Share of all frames with a fix and an error below the limit, by default `SUCCESS_KM`.
    wrong_and_confident : Estimate
        Share of all frames with a fix whose error is the limit or more.
    median_error_km, p90_error_km : Estimate
        Quantiles over all frames; frames without a fix count as infinite.
    star_precision, star_recall : Estimate
        Pooled over frames, see `benchmark.judge.star_id`.
    median_time_ms, p95_time_ms : Estimate
        Time per frame, refused frames included.
    """

    n_frames: int
    n_fixes: int
    n_refused: int
    n_errors: int
    recall: Estimate
    wrong_and_confident: Estimate
    median_error_km: Estimate
    p90_error_km: Estimate
    star_precision: Estimate
    star_recall: Estimate
    median_time_ms: Estimate
    p95_time_ms: Estimate


def summarise(scores: Sequence[FrameScore], limit_km: float = SUCCESS_KM) -> Summary:
    """Summarise the scores of one solver over a set of frames, as `benchmark.stats.frame_metrics` does for their table."""
    resamples = Resamples.of([score.site or f"frame {score.frame_id}" for score in scores])
    conditions = [math.nan if score.condition is None else score.condition for score in scores]
    fixed = [score.status == FIX for score in scores]
    near = [score.error_km < limit_km for score in scores]
    errors_km = [score.error_km for score in scores]
    times_ms = [score.time_ms for score in scores]
    correct = [score.n_correct for score in scores]
    # A solver whose fixes name no star returns no matches, so its recall is undefined.
    names_none = any(fixed) and not any(score.n_matches for score in scores)
    detected = [0 if names_none else score.n_detected_stars for score in scores]
    return Summary(
        n_frames=len(scores),
        n_fixes=sum(fixed),
        n_refused=sum(score.status == REFUSED for score in scores),
        n_errors=sum(score.status == ERROR for score in scores),
        recall=share_within_conditions(near, conditions, resamples),
        wrong_and_confident=share_within_conditions(
            [fix and not hit for fix, hit in zip(fixed, near, strict=True)], conditions, resamples
        ),
        median_error_km=quantile_estimate(errors_km, 0.5, resamples),
        p90_error_km=quantile_estimate(errors_km, 0.9, resamples),
        star_precision=proportion_estimate(correct, [score.n_matches for score in scores], resamples),
        star_recall=proportion_estimate(correct, detected, resamples),
        median_time_ms=quantile_estimate(times_ms, 0.5, resamples),
        p95_time_ms=quantile_estimate(times_ms, 0.95, resamples),
    )


def by_bortle(scores: Sequence[FrameScore], limit_km: float = SUCCESS_KM) -> list[tuple[int | None, Summary]]:
    """Summaries by Bortle class, in ascending order; frames without a class come last, under None."""
    classes = sorted({score.bortle for score in scores}, key=lambda bortle: math.inf if bortle is None else bortle)
    return [(bortle, summarise([score for score in scores if score.bortle == bortle], limit_km)) for bortle in classes]
