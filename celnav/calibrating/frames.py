"""Input of a calibration: detections of frames, and the positions of the stars over the place at their times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from celnav.detections import Detections
from celnav.errors import ConfigError
from celnav.position import Weather
from celnav.sky.astrometry import celestial_to_terrestrial, enu_rotation, terrestrial_stars
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.refraction import refraction_rad
from celnav.sky.utc import Utc, parse_utc

F8 = NDArray[np.float64]

LOWEST_ALTITUDE_DEG = 5.0
"""Stars below it are left out: there, real refraction differs from the standard model by more than a fraction of a pixel."""
_NO_AIR_BELOW = -0.01
FAINTEST_MAG, DEEP_MAG = 8.0, 10.0
"""Limiting magnitudes of the stars that are looked for: in usual fields, and in narrow ones (`sky_index.NARROW`)."""


@dataclass(frozen=True, eq=False)
class CalibrationFrame:
    """One frame of the camera.

    Attributes
    ----------
    detections : Detections
        From `celnav.detect`.
    utc : Utc
        Middle of the exposure; a str or datetime, as for `celnav.solve`, is converted.
    size : tuple of int
        Width and height, pixels.
    name : str
        Name for messages and tables.
    exposure_s : float or None
        Exposure time; None if unknown.
    """

    detections: Detections
    utc: Utc
    size: tuple[int, int]
    name: str = ""
    exposure_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "utc", parse_utc(self.utc))
        if self.detections.shape is not None and self.detections.shape != self.size[::-1]:
            raise ConfigError(f"frame {self.name}: detections are of another size of frame than {self.size}")

    @property
    def uv(self) -> F8:
        """Centroids, shape (n, 2), brightest first."""
        return self.detections.uv


@dataclass(frozen=True)
class Site:
    """Position of the camera, the air there, and UT1-UTC (s; None takes it from the IERS table)."""

    lat_deg: float
    lon_deg: float
    weather: Weather
    dut1_s: float | None = None


@dataclass(frozen=True, eq=False)
class Sky:
    """Stars over the site at the time of one frame, brightest first.

    Attributes
    ----------
    dirs : ndarray, shape (n, 3)
        Apparent directions, refraction included, east-north-up.
    v_mag : ndarray, shape (n,)
        Magnitudes.
    star_id : ndarray of int32, shape (n,)
        Star ids.
    enu_of_icrs : ndarray, shape (3, 3)
        Rotation from the catalogue's axes to east, north, up.
    site, utc
        Place and time.
    """

    dirs: F8
    v_mag: F8
    star_id: NDArray[np.int32]
    enu_of_icrs: F8
    site: Site
    utc: Utc

    @cached_property
    def altitude_deg(self) -> F8:
        """Apparent altitudes, shape (n,)."""
        return np.asarray(np.degrees(np.arcsin(np.clip(self.dirs[:, 2], -1, 1))))

    def magnitude_of(self, predicted: F8, size: tuple[int, int], count: int) -> float:
        """Return the magnitude down to which a frame contains `count` stars, from their predicted positions, shape (n, 2)."""
        u, v = np.nan_to_num(predicted, nan=-1e6).T
        inside = np.flatnonzero((u > -0.5) & (u < size[0] - 0.5) & (v > -0.5) & (v < size[1] - 0.5))
        return float(self.v_mag[inside[:count][-1]]) if len(inside) else -np.inf


def sky_over(site: Site, utc: Utc, faintest_mag: float = FAINTEST_MAG, lowest_deg: float = LOWEST_ALTITUDE_DEG) -> Sky:
    """Return the stars above an apparent altitude (-90 deg: all stars) as seen from the site at an instant."""
    catalog = load_catalog()
    catalog = catalog.take(slice(int(np.searchsorted(catalog.v_mag, faintest_mag))))
    orientation = earth_orientation(utc, site.dut1_s)
    to_terrestrial = celestial_to_terrestrial(utc, orientation)
    true = terrestrial_stars(catalog, utc, orientation, to_terrestrial).enu(site.lat_deg, site.lon_deg)
    high = np.flatnonzero(true[:, 2] > np.sin(np.radians(max(lowest_deg - 0.5, -90.0))))
    dirs = apparent(true[high], site.weather)
    above = dirs[:, 2] > np.sin(np.radians(lowest_deg))
    rows = high[above]
    turned = enu_rotation(site.lat_deg, site.lon_deg) @ to_terrestrial
    return Sky(dirs[above], catalog.v_mag[rows], catalog.star_id[rows], turned, site, utc)


def apparent(true_enu: F8, weather: Weather) -> F8:
    """Lift geometric directions, shape (n, 3), by refraction; those below the horizon stay unchanged.

    `refraction_rad` needs the apparent zenith distance, which is found by iteration; at 5 deg of altitude the fifth round
    changes it by less than 0.01 arcsec.
    """
    if weather.pressure_hpa <= 0:
        return true_enu
    if (lower := true_enu[:, 2] < _NO_AIR_BELOW).any():
        lifted = true_enu.copy()
        lifted[~lower] = apparent(true_enu[~lower], weather)
        return lifted
    across = np.hypot(true_enu[:, 0], true_enu[:, 1])
    true_zd = np.arctan2(across, true_enu[:, 2])
    bent = np.zeros(len(true_zd))
    for _ in range(5):
        bent = refraction_rad(true_zd - bent, weather.pressure_hpa, weather.temperature_c)
    seen_zd = true_zd - bent
    scale = np.sin(seen_zd) / np.maximum(across, 1e-12)
    return np.column_stack((true_enu[:, 0] * scale, true_enu[:, 1] * scale, np.cos(seen_zd)))


def nights_of(frames: list[CalibrationFrame], lon_deg: float) -> NDArray[np.intp]:
    """Return the night of each frame, counted from local mean noon to noon in order of time; shape (number of frames,)."""
    day = np.array([np.floor(frame.utc.mjd + lon_deg / 360 - 0.5) for frame in frames])
    return np.unique(day, return_inverse=True)[1]
