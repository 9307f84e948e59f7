"""Stars of a photograph whose place and time are known: where they must be, and what of their light is measured there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from benchmark.importing.known_sky import KnownSky
from benchmark.importing.photometry import measure_light
from benchmark.importing.told import ToldCamera
from benchmark.twin.alignment import align
from celnav.camera import Camera
from generator.frame.record import STAR_SCHEMA
from generator.places.ephemeris import PLANET_ID_BASE
from generator.reading.stars import photograph_schema

Floats = NDArray[np.float64]

ALIGNED_MAG = 5.0
"""Faintest star that the attitude is found by."""
LOWEST_DEG = 8.0
"""Altitude below which a star is not used for that."""
FOUND_PX = 3.0
"""Uncertainty up to which the stars near the told places are looked for."""
LEAST_ALIGNED = 20
"""Stars that must agree: fewer are found by chance among some hundred."""
MOST_SIGMAS = 5.0
"""Of the told attitude, within which the stars' must lie."""
FARTHEST_PX = 2.0
"""Distance of its light from its place beyond which it is another's."""
PHOTOGRAPH_STARS = photograph_schema(STAR_SCHEMA)


@dataclass(frozen=True, eq=False)
class Pointing:
    """Where a camera pointed, by the stars of its photograph.

    Attributes
    ----------
    R_cam : (3, 3) array
        ENU to camera; the told one where too few stars agree.
    stars : int
        That agree, 0 where it is the told one.
    rms_px : float or None
        Of their residuals an axis.
    turned_deg : float or None
        From the told attitude.
    """

    R_cam: Floats
    stars: int
    rms_px: float | None
    turned_deg: float | None

    @property
    def named(self) -> bool:
        """Whether the stars confirm it, so that they have names."""
        return self.stars > 0


def find_pointing(pixels: NDArray[np.uint16], told: ToldCamera, sky: KnownSky) -> Pointing:
    """Find the attitude at which the known sky lies on the photograph, near the told one."""
    unaligned = Pointing(told.R_cam, 0, None, None)
    if told.sigma_px > FOUND_PX:
        return unaligned
    used = (sky.stars.v_mag < ALIGNED_MAG) & (sky.middle.altitude_deg > LOWEST_DEG)
    found = align(pixels.astype(np.float32), np.ones(pixels.shape, bool), told.camera, told.R_cam, sky.middle.enu[used])
    sigma_deg = math.hypot(told.tilt_sigma_deg, told.tilt_sigma_deg, told.heading_sigma_deg)
    farthest_deg = MOST_SIGMAS * sigma_deg or math.degrees(FOUND_PX / told.camera.f_px)
    if found.stars < LEAST_ALIGNED or found.turned_deg > farthest_deg:
        return unaligned
    # Digits beyond hundredths of an arcsecond are those of the machine's arithmetic.
    left, _, right = np.linalg.svd(np.round(found.R_cam, 8))
    return Pointing(left @ right, found.stars, float(found.rms_px), float(found.turned_deg))


def star_rows(
    pixels: NDArray[np.uint16],
    camera: Camera,
    pointing: Pointing,
    sky: KnownSky,
    identity: tuple[int, str],
    bits: int,
    gain_e_per_dn: float | None,
) -> pa.Table:
    """Rows of the stars of a photograph; what cannot be known is empty. None where the stars cannot be named.

    Parameters
    ----------
    pixels : (height, width) array
    camera : Camera
    pointing : Pointing
    sky : KnownSky
    identity : (int, str)
        Index and id of the frame.
    bits : int
        Of the image's DN.
    gain_e_per_dn : float or None
        Where it is known, the stars' electrons are those measured.
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
        "electrons_e": np.where(own, np.maximum(light.flux, 0.0) * (gain_e_per_dn or np.nan), np.nan),
        "fraction_in_frame": np.ones(len(rows)),
        "snr": np.where(own, light.snr, np.nan),
        "saturated": pa.array((light.highest >= 2**bits - 1).tolist(), pa.bool_(), mask=~own),
        "occluded": pa.nulls(len(rows), pa.bool_()),
        **dict.fromkeys(("hidden_fraction", "cloud_optical_depth", "cloud_transmission", "scintillation"), empty),
    }
    arrays = [_column(columns[field.name], field) for field in PHOTOGRAPH_STARS]
    return pa.Table.from_arrays(arrays, schema=PHOTOGRAPH_STARS)


def _pair(prefix: str, uv: Floats) -> dict[str, Floats]:
    """Columns of a place, to a millionth of a pixel."""
    rounded = np.round(uv, 6)
    return {f"{prefix}u_px": rounded[:, 0], f"{prefix}v_px": rounded[:, 1]}


def _column(values: NDArray[np.generic] | pa.Array, field: pa.Field) -> pa.Array:
    """A column, with empty cells in place of NaN."""
    if isinstance(values, pa.Array):
        return values
    return pa.array(values.astype(field.type.to_pandas_dtype()), field.type, from_pandas=field.nullable)
