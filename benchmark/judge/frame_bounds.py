"""The Cramér-Rao bounds of a dataset's frames, computed from their records and their truth."""

from __future__ import annotations

import math

import numpy as np

from benchmark.frames.dataset import Frame, true_observation
from benchmark.frames.record_values import optional_number, read_record
from benchmark.judge.cramer_rao import Prior, bound_km
from benchmark.judge.geodesy import ROTATION_RAD_S, radii_of_curvature_km
from benchmark.judge.place_information import StarLight, background_variance


def light_of(frame: Frame) -> StarLight | None:
    """Gather the true light of a frame, whatever solvers receive.

    It is read anew from the frame's record (``camera``, ``attitude.R_cam``, ``optics.psf_sigma_px``); None where there is no
    record, or where the record does not state the width of the point spread function.

    Raises
    ------
    DatasetError
        The record is damaged.
    """
    if not frame.image_path.name:
        return None  # created in memory, without image or record
    path = frame.record_path or frame.image_path.with_suffix(".json")
    record = read_record(path)
    sigma_px = optional_number(path, record, "optics.psf_sigma_px")
    if sigma_px is None:
        return None
    seen, truth = true_observation(path, record), frame.truth
    return StarLight(
        uv=truth.uv,
        electrons_e=truth.electrons_e,
        background_e2=background_variance(truth.electrons_e, truth.snr, sigma_px),
        streak_px=np.zeros_like(truth.uv) if truth.streak_px is None else truth.streak_px,
        psf_sigma_px=sigma_px,
        camera=seen.camera,
        R_cam=seen.R_cam,
        latitude_deg=frame.conditions.latitude_deg,
    )


def ground_speed_km_s(latitude_deg: float) -> float:
    """Speed of a place on WGS84 about the Earth's axis: the error of the longitude per second of error of the time."""
    return ROTATION_RAD_S * radii_of_curvature_km(latitude_deg)[0] * math.cos(math.radians(latitude_deg))


def bound_of(frame: Frame) -> float | None:
    """Least root-mean-square position error, km, for a solver with the stated uncertainties of attitude, lens and time.

    None where the frame has no bound: the record does not state the width of the point spread function, the stars do not
    determine a position, or the frame is not the first of its sequence, so that a solver may know more than the frame says.
    """
    if frame.observation.sequence is not None and frame.observation.sequence.index:
        return None
    light = light_of(frame)
    if light is None:
        return None
    given = frame.observation
    prior = Prior(given.tilt_sigma_deg, given.heading_sigma_deg, given.focal_sigma, given.principal_point_sigma_px)
    bound = bound_km(light, prior)
    # An error of the time rotates the sky about the pole, as a change of longitude does; the two add in quadrature.
    bound = math.hypot(bound, given.utc_sigma_s * ground_speed_km_s(light.latitude_deg))
    return bound if math.isfinite(bound) else None
