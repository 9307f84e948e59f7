"""Stars over a place by ERFA's whole chain, laid on a sensor by OpenCV: what calibrations are tested with."""

from __future__ import annotations

from datetime import datetime

import cv2
import erfa
import numpy as np

from celnav.calibrating.frames import CalibrationFrame
from celnav.detections import Detections
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

LAT_DEG, LON_DEG = 34.5, -111.4


def apparent_stars(
    utc: str,
    v_max: float,
    lat_deg: float = LAT_DEG,
    lon_deg: float = LON_DEG,
    hpa: float = 1010.0,
    celsius: float = 10.0,
):
    """East-north-up directions, refraction in air of a pressure and a temperature included, and magnitudes above 15 deg."""
    stars = load_catalog()
    stars = stars.take(np.flatnonzero(stars.v_mag <= v_max))
    earth = earth_orientation(parse_utc(utc))
    moment = datetime.fromisoformat(utc)
    jd1, jd2 = erfa.dtf2d(
        "UTC",
        moment.year,
        moment.month,
        moment.day,
        moment.hour,
        moment.minute,
        moment.second + moment.microsecond / 1e6,
    )
    years = 2000.0 - stars.epoch_jyear
    pm_ra = stars.pm_ra_mas_yr * erfa.DMAS2R / np.cos(stars.dec_rad)
    pm_dec = stars.pm_dec_mas_yr * erfa.DMAS2R
    azimuth, zenith, *_ = erfa.atco13(
        stars.ra_rad + pm_ra * years, stars.dec_rad + pm_dec * years, pm_ra, pm_dec,
        np.maximum(stars.parallax_mas / 1000, 1e-4), 0.0, jd1, jd2, earth.dut1_s, np.radians(lon_deg), np.radians(lat_deg),
        0.0, earth.xp_arcsec * erfa.DAS2R, earth.yp_arcsec * erfa.DAS2R, hpa, celsius, 0.5, 0.55,
    )  # fmt: skip
    enu = np.column_stack((np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)))
    high = zenith < np.radians(75)
    return enu[high], stars.v_mag[high]


def fisheye_positions(enu, R_cam, parameters):
    """Positions by ``cv2.fisheye``; parameters are f, cx, cy, k1 to k4."""
    f_px, cx, cy, *k = parameters
    matrix = np.array([[f_px, 0, cx], [0, f_px, cy], [0, 0, 1.0]])
    rotation = cv2.Rodrigues(R_cam)[0]
    return cv2.fisheye.projectPoints(enu[:, None], rotation, np.zeros(3), matrix, np.array(k, dtype=float))[0][:, 0]


def perspective_positions(enu, R_cam, parameters):
    """Positions by ``cv2.projectPoints``; parameters are f, cx, cy, and OpenCV's coefficients in its order."""
    f_px, cx, cy, *coefficients = parameters
    matrix = np.array([[f_px, 0, cx], [0, f_px, cy], [0, 0, 1.0]])
    rotation = cv2.Rodrigues(R_cam)[0]
    return cv2.projectPoints(enu, rotation, np.zeros(3), matrix, np.array(coefficients, dtype=float))[0][:, 0]


def frame_of(utc, uv, v_mag, size, rng, *, sigma_px=0.2, missing=0.1, false=100, scatter_mag=0.2, visible=None):
    """Make a frame of noisy centroids: some stars missing, some detections false; also the rows of the stars seen."""
    inside = (uv > 0).all(axis=1) & (uv[:, 0] < size[0] - 1) & (uv[:, 1] < size[1] - 1)
    inside &= np.ones(len(uv), dtype=bool) if visible is None else visible
    rows = np.flatnonzero(inside & (rng.random(len(uv)) > missing))
    seen = uv[rows] + rng.normal(0, sigma_px, (len(rows), 2))
    clutter = rng.uniform(0, 1, (false, 2)) * (np.array(size) - 1)
    mags = np.concatenate((v_mag[rows] + rng.normal(0, scatter_mag, len(rows)), rng.uniform(2, v_mag.max(), false)))
    order = np.argsort(mags)
    found = Detections(
        np.concatenate((seen, clutter))[order], 10 ** (-0.4 * mags[order]), size[::-1], np.full(len(order), sigma_px)
    )
    return CalibrationFrame(found, parse_utc(utc), size, utc), rows
