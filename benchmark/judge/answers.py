"""Answers compared with the truth: rejected where they are invalid, judged otherwise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from benchmark.frames.dataset import Frame
from benchmark.frames.identity import UNKNOWN, FrameIdentity
from benchmark.frames.sites import counted_site
from benchmark.judge.geodesy import east_north_km, geodesic_km
from benchmark.judge.outcome import DetectionRow, FrameDetails, SolverOutcome
from benchmark.judge.star_id import score_matches
from benchmark.protocol import Answer, Detections
from benchmark.stats.metrics import ERROR, FrameScore

LONGEST_REASON = 200
LARGEST_COVARIANCE_KM2 = 1e12
"""Two thousand times the surface of the Earth; a larger covariance is no claim about a position."""
FARTHEST_PX = 1e6
"""Largest distance of a detection from the image's corner, px."""


@dataclass(frozen=True, eq=False)
class Response:
    """A solver's answer to one frame as its session received it, with its cost.

    Attributes
    ----------
    answer : Answer
        An answer that `check_answer` accepts; a refusal with its reason where something went wrong.
    status : str
        ``fix``, ``refused`` or ``error``.
    uv : ndarray, shape (n, 2)
        Detections that the answer's matches point to, px.
    flux : ndarray, shape (n,)
        Their brightness, NaN where unknown.
    detect_ms, solve_ms : float
        Wall-clock time of detection and of the rest.
    peak_memory_mib : float or None
        Largest resident memory of the solving process during the request; None where the system does not report it.
    """

    answer: Answer
    status: str
    uv: NDArray[np.float64]
    flux: NDArray[np.float64]
    detect_ms: float
    solve_ms: float
    peak_memory_mib: float | None


def failure(error: Exception | str, time_ms: float, shared: Detections | None = None) -> Response:
    """Response recorded where a solver raised or gave an invalid answer: a refusal with status ``error`` and the reason.

    Parameters
    ----------
    error : Exception or str
        A text is used as the reason without changes.
    time_ms : float
        Time until the failure.
    shared : Detections, optional
        Those that the solver was given, which count as those of any refusal.
    """
    text = error if isinstance(error, str) else f"error: {type(error).__name__}: {error}"
    answer = Answer(ok=False, reason=plain_words(text, LONGEST_REASON))
    uv, flux = (np.empty((0, 2)), np.empty(0)) if shared is None else points_of(shared)
    return Response(answer, ERROR, uv, flux, 0.0, time_ms, None)


def points_of(detections: Detections) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Copy positions and fluxes, so that the solver cannot change what is judged; NaN for an unknown flux."""
    uv = np.array(detections.uv, dtype=np.float64)
    flux = np.full(len(uv), np.nan) if detections.flux is None else np.array(detections.flux, dtype=np.float64)
    return uv, flux


def check_points(uv: NDArray[np.float64], flux: NDArray[np.float64]) -> None:
    """Refuse detections that are not (n, 2) positions within `FARTHEST_PX` and n fluxes. Raises ValueError."""
    if uv.ndim != 2 or uv.shape[1] != 2 or flux.shape != (len(uv),):
        raise ValueError(f"detections of shapes {uv.shape} and {flux.shape}")
    if not (np.abs(uv) <= FARTHEST_PX).all():
        raise ValueError(f"a detection is not within {FARTHEST_PX:g} px of the image's corner")


def plain_words(text: str, longest: int) -> str:
    """Put a text of unknown origin on one line, cut to a number of characters; what UTF-8 cannot encode becomes ``?``."""
    return " ".join(text.encode("utf-8", "replace").decode().split())[:longest]


def check_answer(answer: Answer, n_detections: int) -> None:
    """Refuse an answer that cannot be scored.

    Raises
    ------
    ValueError
        A fix without a possible position (a longitude within a full turn of Greenwich); matches that are not (m, 2) integers,
        or that point to no detection or twice to the same one; a covariance that is not 2x2, symmetric, within
        `LARGEST_COVARIANCE_KM2` and without a negative eigenvalue; a confidence outside 0 to 1.
    """
    if answer.ok:
        lat, lon = answer.lat_deg, answer.lon_deg
        if lat is None or lon is None or not (abs(lat) <= 90.0 and abs(lon) <= 360.0):
            raise ValueError(f"fix at impossible position ({lat}, {lon})")
    matches = answer.matches
    if matches.ndim != 2 or matches.shape[1] != 2 or not np.issubdtype(matches.dtype, np.integer):
        raise ValueError(f"matches of shape {matches.shape} and type {matches.dtype}")
    claimed = matches[:, 0]
    if len(claimed) and (claimed.min() < 0 or claimed.max() >= n_detections):
        raise ValueError("a match points to no detection")
    if len(np.unique(claimed)) != len(claimed):
        raise ValueError("a detection is matched twice")
    cov = answer.cov_km2
    if cov is not None and not (cov.shape == (2, 2) and (np.abs(cov) <= LARGEST_COVARIANCE_KM2).all()):
        raise ValueError(f"covariance is not a 2x2 matrix within {LARGEST_COVARIANCE_KM2:g} km^2")
    if cov is not None and not np.allclose(cov, cov.T):
        raise ValueError("covariance is not symmetric")
    if cov is not None and not is_covariance(float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])):
        raise ValueError("covariance has a negative variance, or its square of cov_en is above cov_ee cov_nn")
    if answer.confidence is not None and not 0.0 <= answer.confidence <= 1.0:
        raise ValueError(f"confidence {answer.confidence} is not within 0 to 1")


def is_covariance(ee: float, en: float, nn: float) -> bool:
    """Whether three numbers can be a covariance, with a tolerance for rounding."""
    return ee >= 0.0 and nn >= 0.0 and en**2 <= ee * nn * (1 + 1e-9)


def judge_answer(
    frame: Frame, response: Response, crlb_km: float | None, identity: FrameIdentity = UNKNOWN
) -> SolverOutcome:
    """Judge an answer by the frame's truth.

    Parameters
    ----------
    frame : Frame
    response : Response
    crlb_km : float or None
        The frame's Cramér-Rao bound, see `benchmark.judge.frame_bounds`.
    identity : FrameIdentity
        Identity of the frame, for the record.
    """
    answer, conditions = response.answer, frame.conditions
    error_km = math.inf
    lat_deg = lon_deg = east_km = north_km = None
    if answer.ok and answer.lat_deg is not None and answer.lon_deg is not None:
        lat_deg, lon_deg = answer.lat_deg, answer.lon_deg
        places = conditions.latitude_deg, conditions.longitude_deg, lat_deg, lon_deg
        error_km = geodesic_km(*places)
        east_km, north_km = east_north_km(*places)
    # A refused frame claims no matches, whatever the solver had found by then.
    matches = answer.matches if answer.ok else np.empty((0, 2), dtype=np.int64)
    stars = score_matches(response.uv, matches, frame.truth)
    star_ids: list[int | None] = [None] * len(response.uv)
    rights: list[bool | None] = [None] * len(response.uv)
    for detection, star, right in zip(*matches.T.tolist(), stars.correct.tolist(), strict=True):
        star_ids[detection], rights[detection] = star, right
    flux = [value if math.isfinite(value) else None for value in response.flux.tolist()]
    columns = range(len(response.uv)), *response.uv.T.tolist(), flux, star_ids, rights
    rows = tuple(map(DetectionRow, repeat(frame.frame_id), *columns))
    site = counted_site(frame)
    score = FrameScore(
        frame_id=frame.frame_id,
        index=frame.index,
        bortle=conditions.bortle,
        width_px=frame.observation.camera.width,
        height_px=frame.observation.camera.height,
        status=response.status,
        reason=answer.reason if not answer.ok else "",
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        error_km=error_km,
        n_detections=len(response.uv),
        n_detected_stars=stars.n_detected_stars,
        n_matches=stars.n_matches,
        n_correct=stars.n_correct,
        time_ms=response.detect_ms + response.solve_ms,
        site=site,
        condition=frame.condition,
    )
    cov = answer.cov_km2 if answer.ok else None
    details = FrameDetails(
        cov_km2=None if cov is None else (float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])),
        confidence=answer.confidence,
        detect_ms=response.detect_ms,
        solve_ms=response.solve_ms,
        stage_ms=dict(answer.time_ms),
        utc=frame.observation.utc,
        conditions=conditions,
        site=site,
        error_east_km=east_km,
        error_north_km=north_km,
        crlb_km=crlb_km,
        peak_memory_mib=response.peak_memory_mib,
        identity=identity,
    )
    return SolverOutcome(score, details, rows)
