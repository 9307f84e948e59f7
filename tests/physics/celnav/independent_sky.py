"""A forward model that shares nothing with celnav's: ERFA's whole chain, its refraction, and OpenCV's projection."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import cv2
import erfa
import numpy as np

from celnav.sky.catalog import load_catalog

ZENITH_NORTH_UP = np.diag([-1.0, -1.0, 1.0])
WIDTH, HEIGHT = 1080, 720
F_PX = WIDTH / 2 / np.tan(np.radians(60))


@dataclass(frozen=True)
class Frame:
    utc: str
    lat_deg: float
    lon_deg: float
    uv: np.ndarray
    star_id: np.ndarray
    flux: np.ndarray


def sites(n, seed):
    """Random UTC strings, latitudes and longitudes, uniform on the Earth, 2000 to 2025."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        moment = datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=int(rng.integers(0, 26 * 365 * 86400)))
        yield (
            moment.strftime("%Y-%m-%dT%H:%M:%SZ"),
            float(np.degrees(np.arcsin(rng.uniform(-1, 1)))),
            float(rng.uniform(-180, 180)),
        )


def make_frame(utc, lat_deg, lon_deg, v_max, orientation, R_cam=ZENITH_NORTH_UP, pressure_hpa=1010.0):
    """Every star down to `v_max` in a 1080x720 frame of 120 degrees, brightest first."""
    catalog = load_catalog()
    # Stars without a parallax get a tenth of a milliarcsecond: ERFA's space motion wants a distance.
    stars = catalog.take(np.flatnonzero(catalog.v_mag <= v_max))
    moment = datetime.fromisoformat(utc)
    jd1, jd2 = erfa.dtf2d(
        "UTC", moment.year, moment.month, moment.day, moment.hour, moment.minute, float(moment.second)
    )
    years = 2000.0 - stars.epoch_jyear
    dec = stars.dec_rad + stars.pm_dec_mas_yr * erfa.DMAS2R * years
    pm_ra = stars.pm_ra_mas_yr * erfa.DMAS2R / np.cos(stars.dec_rad)
    # erfa.atco13 in its two steps, so that what belongs to the instant is computed once and not for every star.
    context, _ = erfa.apco13(
        jd1,
        jd2,
        orientation.dut1_s,
        np.radians(lon_deg),
        np.radians(lat_deg),
        0.0,
        orientation.xp_arcsec * erfa.DAS2R,
        orientation.yp_arcsec * erfa.DAS2R,
        pressure_hpa,
        10.0,
        0.0,
        0.55,
    )
    ra, dec = erfa.atciq(
        stars.ra_rad + pm_ra * years,
        dec,
        pm_ra,
        stars.pm_dec_mas_yr * erfa.DMAS2R,
        np.maximum(stars.parallax_mas / 1000, 1e-4),
        0.0,
        context,
    )
    azimuth, zenith, *_ = erfa.atioq(ra, dec, context)
    enu = np.column_stack((np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)))
    seen = enu @ R_cam.T
    front = np.flatnonzero((seen[:, 2] > 0.05) & (zenith < np.radians(85)))
    matrix = np.array([[F_PX, 0, (WIDTH - 1) / 2], [0, F_PX, (HEIGHT - 1) / 2], [0, 0, 1]])
    uv = cv2.projectPoints(seen[front], np.zeros(3), np.zeros(3), matrix, None)[0][:, 0]
    inside = (uv >= -0.5).all(axis=1) & (uv[:, 0] <= WIDTH - 0.5) & (uv[:, 1] <= HEIGHT - 0.5)
    rows = front[inside]
    return Frame(utc, lat_deg, lon_deg, uv[inside], stars.star_id[rows], 10 ** (-0.4 * stars.v_mag[rows]))


def distance_km(lat1, lon1, lat2, lon2):
    """Great-circle distance on a sphere of 6371 km (haversine)."""
    a, b, c, d = np.radians([lat1, lon1, lat2, lon2])
    return 2 * 6371 * np.arcsin(np.sqrt(np.sin((c - a) / 2) ** 2 + np.cos(a) * np.cos(c) * np.sin((d - b) / 2) ** 2))


def render(frame, electrons_of_v0=4e4, sky=200.0, sigma_px=0.8):
    """A noise-free image: pixel-integrated Gaussians on a vignetted, sloping sky."""
    from scipy.special import erf

    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    image = sky * (1 + u / WIDTH / 2) / np.sqrt(1 + ((u - WIDTH / 2) ** 2 + (v - HEIGHT / 2) ** 2) / F_PX**2)

    def part(x, centre):
        return 0.5 * (erf((x - centre + 0.5) / sigma_px / 2**0.5) - erf((x - centre - 0.5) / sigma_px / 2**0.5))

    for (x, y), flux in zip(frame.uv, frame.flux, strict=True):
        rows = slice(max(0, round(y) - 6), max(0, round(y) + 7))
        columns = slice(max(0, round(x) - 6), max(0, round(x) + 7))
        image[rows, columns] += flux * electrons_of_v0 * np.outer(part(v[rows, 0], y), part(u[0, columns], x))
    return image
