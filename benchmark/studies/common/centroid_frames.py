"""Frames of star positions without a picture: the generator's positions, one of two projections, and centroid noise.

They are cheap and exclude all effects of detection. Positions come from the generator's astrometry, so a solver under test
shares no code with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.frames.conditions import FrameConditions
from benchmark.frames.dataset import Frame, TruthStars
from benchmark.protocol import CameraRecord, Observation
from generator.frame.plan import FramePlan, plan_frame
from generator.places.ephemeris import PLANET_ID_BASE
from generator.scenario.file import Scenario
from generator.seeds import random_stream

F8 = NDArray[np.float64]
Projection = Literal["pinhole", "stereographic"]


@dataclass(frozen=True, eq=False)
class StarList:
    """The stars over one site at one instant.

    Attributes
    ----------
    plan : FramePlan
        Site, time and attitude.
    rays : ndarray, shape (n, 3)
        Apparent directions in the camera frame, unit vectors.
    star_id : ndarray of int, shape (n,)
    v_mag : ndarray, shape (n,)
    dec_deg : ndarray, shape (n,)
        ICRS declination.
    """

    plan: FramePlan
    rays: F8
    star_id: NDArray[np.int64]
    v_mag: F8
    dec_deg: F8


@dataclass(frozen=True, eq=False)
class CentroidFrame:
    """A frame for the judge, and the detections that replace its picture."""

    frame: Frame
    detections: celnav.Detections


def list_stars(scenario: Scenario, index: int) -> StarList:
    """Return the stars (no planets) over the site of frame `index` of a scenario, down to the frame's limiting magnitude."""
    plan = plan_frame(scenario, index)
    stars = plan.stars.star_id < PLANET_ID_BASE
    azimuth, altitude = np.radians(plan.middle.azimuth_deg[stars]), np.radians(plan.middle.altitude_deg[stars])
    enu = np.column_stack((np.cos(altitude) * np.sin(azimuth), np.cos(altitude) * np.cos(azimuth), np.sin(altitude)))
    rays = enu @ np.asarray(plan.spec.R_cam).T
    chosen = plan.stars[stars]
    return StarList(plan, rays, chosen.star_id.astype(np.int64), chosen.v_mag.astype(np.float64), plan.dec_deg[stars])


def project(rays: F8, camera: CameraRecord, projection: Projection) -> F8:
    """Project unit vectors, shape (n, 3), to pixels, shape (n, 2); NaN where the projection has no image.

    With theta the angle to the optical axis, the distance from the principal point is f tan(theta) for a pinhole and
    2 f tan(theta/2) for the stereographic projection (J. P. Snyder, Map Projections: A Working Manual, USGS Professional
    Paper 1395, 1987, chapter 21). The two agree at the axis to the second order of theta.
    """
    z = rays[:, 2]
    if projection == "pinhole":
        scale = 1.0 / np.where(z > 0.0, z, np.nan)
    else:
        scale = 2.0 / (1.0 + np.where(z > -1.0 + 1e-9, z, np.nan))
    u = camera.cx_px + camera.f_px * scale * rays[:, 0]
    v = camera.cy_px + camera.fy_px * scale * rays[:, 1]
    return np.column_stack((u, v))


def make_frame(
    stars: StarList, depth_mag: float, projection: Projection = "pinhole", noise_px: float = 0.0, seed: int = 0
) -> CentroidFrame:
    """Make a frame of all stars down to a magnitude.

    Parameters
    ----------
    stars : StarList
    depth_mag : float
        Stars fainter than this give no detection.
    projection : str
        Projection of the frame; the camera that the solver receives is a pinhole in any case.
    noise_px : float
        Standard deviation of the centroids along each axis.
    seed : int
        Seed of the noise, together with the frame's index.
    """
    spec = stars.plan.spec
    camera = CameraRecord(
        model="pinhole",
        width=spec.camera.width,
        height=spec.camera.height,
        f_px=spec.camera.f_px,
        fy_px=spec.camera.f_px,
        cx_px=(spec.camera.width - 1) / 2,
        cy_px=(spec.camera.height - 1) / 2,
    )
    uv = project(stars.rays, camera, projection)
    bright = stars.v_mag <= depth_mag
    with np.errstate(invalid="ignore"):
        inside = (uv > -0.5).all(axis=1) & (uv[:, 0] < camera.width - 0.5) & (uv[:, 1] < camera.height - 0.5) & bright
    rows = np.flatnonzero(inside)
    rows = rows[np.argsort(stars.v_mag[rows], kind="stable")]
    flux = 10.0 ** (-0.4 * stars.v_mag[rows])
    noise = random_stream(seed, "study.centroid_noise", stars.plan.index).normal(0.0, 1.0, (len(rows), 2))
    seen = np.clip(uv[rows] + noise_px * noise, -0.5, [camera.width - 0.5, camera.height - 0.5])
    frame = Frame(
        frame_id=stars.plan.frame_id,
        index=stars.plan.index,
        image_path=Path(),
        observation=Observation(camera, stars.plan.utc_mid.isoformat(), np.asarray(spec.R_cam)),
        conditions=FrameConditions(
            spec.site.latitude_deg, spec.site.longitude_deg, spec.sky.bortle, None, spec.time.exposure_s, len(rows)
        ),
        truth=TruthStars(stars.star_id[rows], uv[rows], flux, np.full(len(rows), math.inf)),
    )
    return CentroidFrame(frame, celnav.Detections(seen, flux, (camera.height, camera.width)))
