"""Stars of a photograph with known place and time: their expected positions, and the light measured there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from benchmark.importing.known_sky import KnownSky
from benchmark.importing.photometry import any_near, measure_light
from benchmark.importing.told import ToldCamera
from benchmark.photographed.alignment import align
from celnav.camera import Camera
from generator.frame.record import STAR_SCHEMA
from generator.places.ephemeris import PLANET_ID_BASE
from generator.reading.stars import photograph_schema

Floats = NDArray[np.float64]

ALIGNED_MAG = 5.0
"""Faintest star that is used to find the attitude."""
LOWEST_DEG = 8.0
"""Altitude below which a star is not used for the attitude."""
FOUND_PX = 3.0
"""Largest uncertainty of the supplied attitude, px, with which stars are searched near their expected positions."""
LEAST_ALIGNED = 20
"""Number of stars that must agree; fewer agree by chance among some hundred."""
MOST_SIGMAS = 5.0
"""Standard deviations of the supplied attitude within which that of the stars must be."""
FARTHEST_PX = 2.0
"""Distance of light from a star's position beyond which it belongs to another star."""
PHOTOGRAPH_STARS = photograph_schema(STAR_SCHEMA)


@dataclass(frozen=True, eq=False)
class Pointing:
    """Pointing of a camera, derived from the stars of its photograph.

    Attributes
    ----------
    R_cam : (3, 3) array
        ENU to camera; the supplied attitude where too few stars agree.
    stars : int
        Number of stars that agree; 0 where the supplied attitude is used.
    rms_px : float or None
        Root mean square of their residuals along each axis.
    turned_deg : float or None
        Angle from the supplied attitude.
    """

    R_cam: Floats
    stars: int
    rms_px: float | None
    turned_deg: float | None

    @property
    def named(self) -> bool:
        """Whether the stars confirm the attitude, so that they can be identified."""
        return self.stars > 0


def find_pointing(pixels: NDArray[np.floating], told: ToldCamera, sky: KnownSky) -> Pointing:
    """Find the attitude, near the supplied one, at which the known sky matches the photograph."""
    unaligned = Pointing(told.R_cam, 0, None, None)
    if told.sigma_px > FOUND_PX:
        return unaligned
    used = (sky.stars.v_mag < ALIGNED_MAG) & (sky.middle.altitude_deg > LOWEST_DEG)
    found = align(pixels.astype(np.float32), np.ones(pixels.shape, bool), told.camera, told.R_cam, sky.middle.enu[used])
    sigma_deg = math.hypot(told.tilt_sigma_deg, told.tilt_sigma_deg, told.heading_sigma_deg)
    farthest_deg = MOST_SIGMAS * sigma_deg or math.degrees(FOUND_PX / told.camera.f_px)
    if found.stars < LEAST_ALIGNED or found.turned_deg > farthest_deg:
        return unaligned
    # Digits beyond hundredths of an arcsecond depend on the machine's arithmetic.
    left, _, right = np.linalg.svd(np.round(found.R_cam, 8))
    return Pointing(left @ right, found.stars, float(found.rms_px), float(found.turned_deg))


def star_rows(
    pixels: NDArray[np.floating],
    full: NDArray[np.bool_],
    camera: Camera,
    pointing: Pointing,
    sky: KnownSky,
    identity: tuple[int, str],
    gain_e_per_dn: float | None,
) -> pa.Table:
    """Rows of the stars of a photograph; unknown values are empty. There are no rows if the stars cannot be identified.

    Parameters
    ----------
    pixels : (height, width) array
        DN.
    full : (height, width) array
        Pixels that are full.
    camera : Camera
    pointing : Pointing
    sky : KnownSky
    identity : (int, str)
        Index and id of the frame.
    gain_e_per_dn : float or None
        Where it is known, the stars' electrons are the measured ones.
    """
    if not pointing.named:
        return PHOTOGRAPH_STARS.empty_table()
    start, uv, end = (camera.project(at.enu @ pointing.R_cam.T) for at in (sky.start, sky.middle, sky.end))
    height, width = pixels.shape
    with np.errstate(invalid="ignore"):
        inside = ((uv > -0.5) & (uv < np.array([width, height]) - 0.5)).all(axis=1)
    rows = np.flatnonzero(inside)
    start, uv, end = (np.where(np.isfinite(at), at, uv)[rows] for at in (start, uv, end))
    light = measure_light(pixels.astype(np.float32), uv)
    own = ~(np.hypot(*(light.uv - uv).T) >= FARTHEST_PX) & np.isfinite(light.snr)
    star_id = sky.stars.star_id[rows]
    centroid = (start + 4.0 * uv + end) / 6.0
    empty = np.full(len(rows), np.nan)
    index, frame_id = identity
    columns = {
        "index": np.full(len(rows), index),
        "frame_id": pa.repeat(frame_id, len(rows)),
        "star_id": star_id,
        "hip": sky.stars.hip[rows],
        "hr": sky.stars.hr[rows],
        "kind": pa.array(np.where(star_id > PLANET_ID_BASE, "planet", "star").tolist(), pa.string()),
        "ra_deg": sky.ra_deg[rows],
        "dec_deg": sky.dec_deg[rows],
        "v_mag": sky.stars.v_mag[rows],
        "bv_mag": sky.stars.bv_mag[rows],
        "azimuth_deg": sky.middle.azimuth_deg[rows],
        "altitude_deg": sky.middle.altitude_deg[rows],
        "airmass": sky.airmass[rows],
        **_pair("", uv),
        **_pair("centroid_", centroid),
        **_pair("light_", np.where(own[:, None], light.uv, np.nan)),
        **_pair("start_", start),
        **_pair("end_", end),
        **_pair("low_", np.minimum(np.minimum(start, end), uv)),
        **_pair("high_", np.maximum(np.maximum(start, end), uv)),
        "electrons_e": np.where(own, np.maximum(light.flux, 0.0) * (gain_e_per_dn or np.nan), np.nan),
        "fraction_in_frame": np.ones(len(rows)),
        "snr": np.where(own, light.snr, np.nan),
        "saturated": pa.array(any_near(full, uv).tolist(), pa.bool_(), mask=~own),
        "occluded": pa.nulls(len(rows), pa.bool_()),
        **dict.fromkeys(("hidden_fraction", "cloud_optical_depth", "cloud_transmission", "scintillation"), empty),
    }
    arrays = [_column(columns[field.name], field) for field in PHOTOGRAPH_STARS]
    return pa.Table.from_arrays(arrays, schema=PHOTOGRAPH_STARS)


def _pair(prefix: str, uv: Floats) -> dict[str, Floats]:
    """Columns of a position, rounded to a millionth of a pixel."""
    rounded = np.round(uv, 6)
    return {f"{prefix}u_px": rounded[:, 0], f"{prefix}v_px": rounded[:, 1]}


def _column(values: NDArray[np.generic] | pa.Array, field: pa.Field) -> pa.Array:
    """A column with empty cells instead of NaN."""
    if isinstance(values, pa.Array):
        return values
    return pa.array(values.astype(field.type.to_pandas_dtype()), field.type, from_pandas=field.nullable)
