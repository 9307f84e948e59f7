"""The messages of docs/solver_protocol.md: writing requests, reading and checking answers.

A program's answer is untrusted: every field is checked for type, size and finiteness before it is used.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.frames.dataset import Frame
from benchmark.judge.answers import LONGEST_REASON, plain_words
from benchmark.protocol import SIGMAS, Answer, Detections, Observation
from benchmark.solvers.attitude_position import position_of_attitude, rays_of_fit
from benchmark.solvers.star_naming import named_matches
from celnav.sky.catalog import unit_vectors

PROTOCOL = "skybench-solver/1"
LARGEST_NUMBER_OF_DETECTIONS = 100_000


@dataclass(frozen=True)
class Reply:
    """A program's checked answer to one frame.

    Attributes
    ----------
    answer : Answer
    uv : ndarray, shape (n, 2)
        Detections to which its matches refer, px.
    flux : ndarray, shape (n,)
        Their brightness; NaN where unknown.
    detect_ms : float
        Duration of detection as the program reports it.
    """

    answer: Answer
    uv: NDArray[np.float64]
    flux: NDArray[np.float64]
    detect_ms: float


def hello() -> dict[str, Any]:
    """The first request."""
    return {"type": "hello", "protocol": PROTOCOL}


def request_of(frame: Frame, shared: Detections | None, image: Path, time_limit_s: float = 10.0) -> dict[str, Any]:
    """Make the request to solve a frame.

    Parameters
    ----------
    frame : Frame
    shared : Detections or None
        Detections that the program is to use; with None it detects by itself.
    image : Path
        Path under which the program reads the frame's image.
    time_limit_s : float
        Most time that it should take, so that time remains for further tries.
    """
    seen = frame.observation
    found = None
    if shared is not None:
        flux = np.full(len(shared.uv), np.nan) if shared.flux is None else np.asarray(shared.flux)
        found = {"uv": np.asarray(shared.uv).tolist(), "flux": [_number_or_none(value) for value in flux]}
    return {
        "type": "solve",
        "frame_id": frame.frame_id,
        "image": str(image.resolve()),
        "camera": seen.camera.as_given(),
        "utc_mid": seen.utc,
        "R_cam": np.asarray(seen.R_cam).tolist(),
        "tilt_sigma_deg": seen.tilt_sigma_deg,
        "heading_sigma_deg": _number_or_none(seen.heading_sigma_deg),
        "pressure_hpa": seen.pressure_hpa,
        "temperature_c": seen.temperature_c,
        **{name: getattr(seen, name) for name in SIGMAS},
        "detections": found,
        "time_limit_s": time_limit_s,
        **({} if seen.sequence is None else {"sequence": seen.sequence.as_given()}),
    }


def answers(message: Mapping[str, Any], frame_id: str) -> bool:
    """Whether a message says that it is the answer to a frame."""
    return message.get("type") == "fix" and message.get("frame_id") == frame_id


def reply_of(message: Mapping[str, Any], frame_id: str, observation: Observation, shared: Detections | None) -> Reply:
    """Read and check an answer.

    Raises
    ------
    ValueError
        It does not conform to docs/solver_protocol.md, or the program reports a failure.
    """
    if not answers(message, frame_id):
        raise ValueError(f"expected the answer to {frame_id}, found type {message.get('type')!r}")
    uv, flux = _points(message.get("detections")) if shared is None else _given(shared)
    status = message.get("status")
    matches = _claimed(message, len(uv))
    lat = lon = None
    if status == "error":
        raise ValueError(plain_words(str(message.get("reason", "no reason given")), LONGEST_REASON))
    if status == "fix":
        lat, lon = _number(message, "lat_deg"), _number(message, "lon_deg")
    elif status == "attitude":
        rotation = _array(message.get("R_icrs_to_camera"), (3, 3), "R_icrs_to_camera")
        if np.abs(rotation).max() > 2.0:
            raise ValueError("R_icrs_to_camera is not a rotation")
        up = observation.R_cam[:, 2]
        seen = rays_of_fit(observation.camera, uv[matches[:, 0]], up)
        air = observation.pressure_hpa, observation.temperature_c
        lat, lon = position_of_attitude(rotation, up, observation.utc, seen, *air)
    elif status != "refused":
        raise ValueError(f"status is {status!r}, expected fix, attitude, refused or error")
    ok = status != "refused"
    cov = None
    if ok and message.get("cov_ee_km2") is not None:
        ee, en, nn = (_number(message, f"cov_{name}_km2") for name in ("ee", "en", "nn"))
        cov = np.array([[ee, en], [en, nn]])
    confidence = None if message.get("confidence") is None else _number(message, "confidence")
    stages = message.get("time_ms") or {}
    if not isinstance(stages, Mapping) or len(stages) > 50:
        raise ValueError("time_ms must be an object of at most 50 numbers")
    time_ms = {plain_words(stage, 50): _number(stages, stage) for stage in stages}
    reason = "" if ok else plain_words(str(message.get("reason", "")), LONGEST_REASON)
    answer = Answer(ok, reason, lat, lon, cov, confidence, matches, time_ms)
    return Reply(answer, uv, flux, max(time_ms.get("detect", 0.0), 0.0))


def _number_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(message: Mapping[str, Any], key: str) -> float:
    value = message.get(key)
    if isinstance(value, int | float) and not isinstance(value, bool):
        with suppress(OverflowError):  # an integer beyond the range of floating-point numbers
            if math.isfinite(number := float(value)):
                return number
    raise ValueError(f"{plain_words(key, 50)} must be a finite number, found {plain_words(str(value), 40)!r}")


def _array(value: Any, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be numbers of shape {shape}") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite numbers of shape {shape}, found shape {array.shape}")
    return array


def _points(found: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if found is None:
        return np.empty((0, 2)), np.empty(0)
    if not isinstance(found, Mapping) or not isinstance(found.get("uv"), list):
        raise ValueError("detections must be an object with uv, and flux or not")
    n = len(found["uv"])
    if n > LARGEST_NUMBER_OF_DETECTIONS:
        raise ValueError(f"{n} detections are more than {LARGEST_NUMBER_OF_DETECTIONS}")
    uv = _array(found["uv"], (n, 2), "detections.uv") if n else np.empty((0, 2))
    listed = found.get("flux")
    if listed is None:
        return uv, np.full(n, np.nan)
    if not isinstance(listed, list) or len(listed) != n:
        raise ValueError(f"detections.flux must be a list of {n} numbers")
    flux = np.full(n, np.nan)
    known = np.array([value is not None for value in listed], dtype=bool)
    flux[known] = _array([value for value in listed if value is not None], (int(known.sum()),), "detections.flux")
    return uv, flux


def _given(shared: Detections) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    uv = np.array(shared.uv, dtype=np.float64)
    flux = np.full(len(uv), np.nan) if shared.flux is None else np.array(shared.flux, dtype=np.float64)
    return uv, flux


def _claimed(message: Mapping[str, Any], n_detections: int) -> NDArray[np.int64]:
    """Matches that the answer claims: stars by their ids, or by their positions in the program's own catalogue."""
    places = message.get("match_directions")
    if not places:
        matches = _matches(message.get("matches"))
    elif message.get("matches"):
        raise ValueError("give either matches or match_directions")
    else:
        if not isinstance(places, list) or len(places) > LARGEST_NUMBER_OF_DETECTIONS:
            raise ValueError("match_directions must be a list of [detection, ra_deg, dec_deg]")
        table = _array(places, (len(places), 3), "match_directions")
        if (table[:, 0] != np.floor(table[:, 0])).any() or not (np.abs(table) < 2**31).all():
            raise ValueError("match_directions must begin with a detection's number")
        ra, dec = np.radians(table[:, 1]), np.radians(table[:, 2])
        matches = named_matches(table[:, 0].astype(np.int64), unit_vectors(ra, dec))
    if len(matches) and (matches[:, 0].min() < 0 or matches[:, 0].max() >= n_detections):
        raise ValueError("a match points to no detection")
    return matches


def _matches(found: Any) -> NDArray[np.int64]:
    if not found:
        return np.empty((0, 2), dtype=np.int64)
    if not isinstance(found, list) or len(found) > LARGEST_NUMBER_OF_DETECTIONS:
        raise ValueError("matches must be a list of [detection, star id]")
    for pair in found:
        proper = isinstance(pair, list) and len(pair) == 2 and all(type(number) is int for number in pair)
        if not proper or not all(-(2**31) <= number < 2**31 for number in pair):
            raise ValueError("matches must be pairs of integers of 32 bits: [detection, star id]")
    return np.array(found, dtype=np.int64)
