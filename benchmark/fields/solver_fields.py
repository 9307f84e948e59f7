"""Random star fields for measuring solvers: positions of stars on a sensor, with noise, gaps, clutter and cloud.

The forward model is ERFA's whole chain (``apco13``, ``atciq``, ``atioq``: aberration, precession-nutation, Earth rotation,
refraction) and a projection written here; from celnav it uses the list of stars and the Earth's orientation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import lru_cache

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from celnav.sky.catalog import StarCatalog, load_catalog
from celnav.sky.earth_rotation import EarthOrientation, earth_orientation
from celnav.sky.utc import parse_utc

F8 = NDArray[np.float64]

WIDTH, HEIGHT = 1080, 720
LOWEST_ALTITUDE_DEG = 5.0
PRESSURE_HPA, TEMPERATURE_C = 1010.0, 10.0


@dataclass(frozen=True)
class Condition:
    """How a field is made.

    Attributes
    ----------
    name : str
        Name in tables.
    hfov_deg : float
        Horizontal field of view, edge to edge.
    v_max : float
        Faintest star, V.
    noise_px : float
        Standard deviation of centroids along each axis.
    missing, false : float
        Fractions of the stars in the field that are not detected, and that are added as clutter with brightnesses drawn from
        the stars'.
    bright_false : int
        Number of clutter points brighter than every star.
    cloud : bool
        Whether half of the frame shows nothing, on one side of a random line through the middle.
    focal_error : float
        Relative excess of the camera's true focal length over the one that the solver receives.
    exact_attitude : bool
        Whether the solver receives the attitude; otherwise only the vertical.
    equidistant : bool
        Whether the lens is an equidistant fisheye instead of a pinhole.
    brightest : int
        Keep only this many stars; 0 keeps all.
    tilt_deg : float
        Largest tilt of the boresight from the zenith.
    """

    name: str
    hfov_deg: float = 120.0
    v_max: float = 6.0
    noise_px: float = 0.0
    missing: float = 0.0
    false: float = 0.0
    bright_false: int = 0
    cloud: bool = False
    focal_error: float = 0.0
    exact_attitude: bool = False
    equidistant: bool = False
    brightest: int = 0
    tilt_deg: float = 20.0

    @property
    def f_px(self) -> float:
        """Focal length that the solver receives, pixels."""
        if self.equidistant:
            return WIDTH / math.radians(self.hfov_deg)
        return WIDTH / 2 / math.tan(math.radians(self.hfov_deg) / 2)


@dataclass(frozen=True, eq=False)
class Field:
    """One field and its truth.

    Attributes
    ----------
    utc : str
        Mid-exposure.
    lat_deg, lon_deg : float
        Position of the camera.
    R_cam : ndarray, shape (3, 3)
        ENU to camera.
    uv, flux : ndarray, shapes (n, 2) and (n,)
        Detections, brightest first.
    star_id : ndarray of int64, shape (n,)
        True identities; 0 for clutter.
    """

    utc: str
    lat_deg: float
    lon_deg: float
    R_cam: F8
    uv: F8
    flux: F8
    star_id: NDArray[np.int64]


@lru_cache(maxsize=8)
def _stars(v_max: float) -> StarCatalog:
    catalog = load_catalog()
    return catalog.take(np.flatnonzero(catalog.v_mag <= v_max))


def apparent_enu(stars: StarCatalog, utc: str, lat_deg: float, lon_deg: float, orientation: EarthOrientation) -> F8:
    """Return the directions, shape (n, 3), in which stars appear, east-north-up, by ERFA."""
    moment = datetime.fromisoformat(utc)
    jd1, jd2 = erfa.dtf2d(
        "UTC", moment.year, moment.month, moment.day, moment.hour, moment.minute, float(moment.second)
    )
    years = 2000.0 - stars.epoch_jyear
    pm_dec = stars.pm_dec_mas_yr * erfa.DMAS2R
    pm_ra = stars.pm_ra_mas_yr * erfa.DMAS2R / np.cos(stars.dec_rad)
    context, _ = erfa.apco13(
        jd1, jd2, orientation.dut1_s, math.radians(lon_deg), math.radians(lat_deg), 0.0,
        orientation.xp_arcsec * erfa.DAS2R, orientation.yp_arcsec * erfa.DAS2R, PRESSURE_HPA, TEMPERATURE_C, 0.0, 0.55,
    )  # fmt: skip
    # Space motion requires a distance: stars without a parallax get a tenth of a milliarcsecond.
    ra, dec = erfa.atciq(
        stars.ra_rad + pm_ra * years, stars.dec_rad + pm_dec * years, pm_ra, pm_dec,
        np.maximum(stars.parallax_mas / 1000, 1e-4), 0.0, context,
    )  # fmt: skip
    azimuth, zenith, *_ = erfa.atioq(ra, dec, context)
    return np.column_stack((np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)))


def random_attitude(rng: np.random.Generator, tilt_deg: float) -> F8:
    """Return R_cam of a camera with random heading, tilted from the zenith by up to `tilt_deg` in a random direction."""
    heading, toward = rng.uniform(0, 2 * math.pi, 2)
    tilt = math.radians(tilt_deg) * math.sqrt(rng.random())
    c, s = math.cos(heading), math.sin(heading)
    zenith_camera = np.array([[-c, s, 0.0], [-s, -c, 0.0], [0.0, 0.0, 1.0]])
    turn = Rotation.from_rotvec([tilt * math.cos(toward), tilt * math.sin(toward), 0.0])
    return np.asarray(turn.as_matrix() @ zenith_camera)


def project(dirs: F8, condition: Condition, f_px: float) -> F8:
    """Project camera-frame directions, shape (n, 3), to pixels; NaN behind a pinhole."""
    x, y, z = dirs.T
    if condition.equidistant:
        across = np.hypot(x, y)
        part = np.arctan2(across, z) / np.maximum(across, 1e-15)
    else:
        part = 1 / np.where(z > 0.02, z, np.nan)
    return np.column_stack(((WIDTH - 1) / 2 + f_px * x * part, (HEIGHT - 1) / 2 + f_px * y * part))


def make_field(condition: Condition, seed: int, number: int) -> Field:
    """Make one field; `number` counts fields of a seed. Site, date (2000 to 2025) and attitude are random."""
    rng = np.random.default_rng([seed, number])
    moment = datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=int(rng.integers(0, 26 * 365 * 86400)))
    utc = moment.strftime("%Y-%m-%dT%H:%M:%SZ")
    lat_deg, lon_deg = math.degrees(math.asin(rng.uniform(-1, 1))), float(rng.uniform(-180, 180))
    R_cam = random_attitude(rng, condition.tilt_deg)
    stars = _stars(condition.v_max)
    enu = apparent_enu(stars, utc, lat_deg, lon_deg, earth_orientation(parse_utc(utc)))
    high = np.flatnonzero(enu[:, 2] > math.sin(math.radians(LOWEST_ALTITUDE_DEG)))
    uv = project(enu[high] @ R_cam.T, condition, condition.f_px * (1 + condition.focal_error))
    inside = (uv[:, 0] >= -0.5) & (uv[:, 0] <= WIDTH - 0.5) & (uv[:, 1] >= -0.5) & (uv[:, 1] <= HEIGHT - 0.5)
    uv, rows = uv[inside], high[inside]
    if condition.brightest:
        uv, rows = uv[: condition.brightest], rows[: condition.brightest]
    flux, ids = 10 ** (-0.4 * stars.v_mag[rows]), stars.star_id[rows].astype(np.int64)
    n = len(uv)
    kept = rng.random(n) >= condition.missing
    if condition.cloud:
        angle = rng.uniform(0, 2 * math.pi)
        kept &= (uv - [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]) @ [math.cos(angle), math.sin(angle)] > 0
    uv = uv[kept] + condition.noise_px * rng.standard_normal((int(kept.sum()), 2))
    n_false, n_bright = round(condition.false * n), condition.bright_false
    clutter = rng.uniform([-0.5, -0.5], [WIDTH - 0.5, HEIGHT - 0.5], (n_false + n_bright, 2))
    clutter_flux = np.concatenate(
        (rng.choice(flux, n_false) * rng.uniform(0.8, 1.25, n_false), flux.max() * rng.uniform(2, 5, n_bright))
    ) if n else np.ones(n_false + n_bright)  # fmt: skip
    uv, flux = np.concatenate((uv, clutter)), np.concatenate((flux[kept], clutter_flux))
    ids = np.concatenate((ids[kept], np.zeros(len(clutter), dtype=np.int64)))
    uv = np.clip(uv, [-0.5, -0.5], [WIDTH - 0.5, HEIGHT - 0.5])
    order = np.argsort(-flux, kind="stable")
    return Field(utc, lat_deg, lon_deg, R_cam, uv[order], flux[order], ids[order])
