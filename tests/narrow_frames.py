"""Frames of narrow fields: stars of the catalogue, stars that the catalogue lacks, false detections, hot pixels."""

from __future__ import annotations

import math

import numpy as np
from calibration_sky import LAT_DEG, LON_DEG, apparent_stars, perspective_positions

from celnav.calibrating.calibration import CameraCalibration
from celnav.calibrating.frames import CalibrationFrame
from celnav.command.pointing import Pointing
from celnav.detections import Detections
from celnav.sky.catalog import load_catalog
from celnav.sky.utc import parse_utc

SIZE = (1280, 960)
UTC = ("2021-08-05T05:30:00+00:00", "2021-08-05T05:40:00+00:00", "2021-08-05T05:50:00+00:00")
PLACE = LAT_DEG, LON_DEG
SIGMA_PX, MISSING, FALSE, HOT = 0.3, 0.1, 0.2, 8


def unlisted_magnitudes(v_max: float, solid_angle_sr: float, rng: np.random.Generator) -> np.ndarray:
    """Magnitudes of stars that Hipparcos lacks: the sky has some 42,000 to V 8, and 2.9 times as many a magnitude deeper."""
    edges = np.append(np.arange(7.0, v_max, 0.25), v_max)
    all_stars = np.diff(10 ** (4.62 + 0.46 * (edges - 8)))
    listed = np.diff(np.searchsorted(load_catalog().v_mag, edges))
    counts = rng.poisson(np.maximum(all_stars - listed, 0) * solid_angle_sr / (4 * math.pi))
    return np.concatenate([rng.uniform(a, b, n) for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)])


class NarrowCamera:
    """A fixed camera of some width, random direction, principal point and first radial term, and its frames."""

    def __init__(self, hfov_deg: float, seed: int, frames: int = 1, v_max: float = 8.5) -> None:
        rng = np.random.default_rng([seed, int(10 * hfov_deg)])
        self.R_cam = Pointing(rng.uniform(0, 360), rng.uniform(35, 85), rng.uniform(-20, 20)).R_cam
        self.f_px = SIZE[0] / 2 / math.tan(math.radians(hfov_deg / 2))
        self.lens = (
            self.f_px,
            *(np.array(SIZE) / 2 - 0.5 + rng.normal(0, 10, 2)),
            rng.uniform(-0.3, 0.3),
            0.0,
            0.0,
            0.0,
        )
        middle = (np.array(SIZE) - 1) / 2
        hot = rng.uniform(0, 2, (HOT, 2)) * middle, rng.uniform(4, v_max, HOT)
        self.frames = [self._frame(utc, v_max, hot, rng) for utc in UTC[:frames]]

    def _frame(self, utc, v_max, hot, rng) -> CalibrationFrame:
        enu, v_mag = apparent_stars(utc, v_max)
        front = (self.R_cam @ enu.T)[2] > math.cos(math.radians(15))
        uv, v_mag = perspective_positions(enu[front], self.R_cam, self.lens), v_mag[front]
        seen = (uv > 0).all(axis=1) & (uv < np.array(SIZE) - 1).all(axis=1) & (rng.random(len(uv)) > MISSING)
        uv, v_mag = uv[seen], v_mag[seen]
        false = np.concatenate(
            (
                unlisted_magnitudes(v_max, math.prod(SIZE) / self.f_px**2, rng),
                rng.choice(v_mag, rng.poisson(FALSE * len(v_mag))),
            )
        )
        places = (
            uv + rng.normal(0, SIGMA_PX, uv.shape),
            rng.uniform(0, 1, (len(false), 2)) * (np.array(SIZE) - 1),
            hot[0],
        )
        mags = np.concatenate((v_mag + rng.normal(0, 0.2, len(v_mag)), false, hot[1]))
        order = np.argsort(mags)
        found = Detections(
            np.concatenate(places)[order], 10 ** (-0.4 * mags[order]), SIZE[::-1], np.full(len(order), SIGMA_PX)
        )
        return CalibrationFrame(found, parse_utc(utc), SIZE, utc)

    def error_px(self, found: CameraCalibration) -> float:
        """Root mean square distance, over the frame, of where the camera found and the true one put a direction."""
        grid = np.stack(np.meshgrid(np.linspace(20, SIZE[0] - 20, 7), np.linspace(20, SIZE[1] - 20, 5)), -1).reshape(
            -1, 2
        )
        dirs = found.camera.to_rays(grid) @ found.attitudes[0].R_cam
        return math.sqrt(((perspective_positions(dirs, self.R_cam, self.lens) - grid) ** 2).sum(axis=1).mean())
