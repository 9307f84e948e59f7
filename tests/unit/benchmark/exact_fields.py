"""Fields of stars at exact apparent places, as pixels and as an image, for tests of solvers."""

from __future__ import annotations

import dataclasses

import numpy as np

import celnav
from benchmark.protocol import CameraRecord, Observation
from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog

UTC = "2021-03-20T22:15:07.25Z"
PLACE = (52.0, 4.36)
PINHOLE = CameraRecord("pinhole", 640, 480, 554.26, 554.26, 319.5, 239.5)
FISHEYE = CameraRecord("equisolid", 900, 900, 300.0, 300.0, 449.5, 449.5)


def told(camera, altitude_deg=75.0):
    azimuth, altitude = np.radians([70.0, altitude_deg])
    boresight = np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])
    right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    R_cam = np.array([right, np.cross(boresight, right), boresight])
    return Observation(camera, UTC, R_cam)


def stars_in(observation, faintest=5.5):
    """Star ids, exact pixels and fluxes of the frame, brightest first."""
    stars = load_catalog()
    stars = stars.take(stars.v_mag < faintest)
    enu = apparent_enu(
        stars, UTC, *PLACE, pressure_hpa=observation.pressure_hpa, temperature_c=observation.temperature_c
    )
    lens = celnav.Camera.from_dict(dataclasses.asdict(observation.camera))
    uv = lens.project(enu @ observation.R_cam.T)
    seen = np.isfinite(uv[:, 0]) & lens.in_frame(np.nan_to_num(uv, nan=-1e6)) & (enu[:, 2] > 0.1)
    return stars.star_id[seen], uv[seen], 10.0 ** (-0.4 * stars.v_mag[seen])


def image_of(observation, sigma_px=1.2, faintest=6.0):
    """Their light through a Gaussian point spread, in 16 bits on a noisy sky."""
    _, uv, flux = stars_in(observation, faintest)
    height, width = observation.camera.height, observation.camera.width
    light = np.random.default_rng(3).normal(400.0, 8.0, (height, width))
    v, u = np.mgrid[-6:7, -6:7]
    for (x, y), brightness in zip(uv, flux, strict=True):
        column, row = round(x), round(y)
        if 6 <= column < width - 6 and 6 <= row < height - 6:
            spread = np.exp(-((u + column - x) ** 2 + (v + row - y) ** 2) / (2.0 * sigma_px**2))
            light[row - 6 : row + 7, column - 6 : column + 7] += 4e5 * brightness * spread
    return np.clip(np.round(light), 0, 65535).astype(np.uint16)
