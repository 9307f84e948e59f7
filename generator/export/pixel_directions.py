"""Directions of pixels: from a frame's record to the ICRS, through lens, attitude, refraction and aberration."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from generator import plugins
from generator.places.astrometry import Air, Site, air_around, apparent_places
from generator.places.catalogue import StarCatalogue
from generator.places.ephemeris import icrs_from_enu
from generator.places.refraction import refraction_of_apparent_deg
from generator.places.times import EarthOrientation, Instant
from generator.scenario.projection import Projection

Floats = NDArray[np.float64]

ROUNDS = 12
"""Number of corrections of a direction; each leaves a thousandth of the error."""
CLOSE_ENOUGH = 1e-9
"""Tolerance of a unit vector, 0.0002 arcsec."""
AIRLESS = Air(0.0, 0.0, 0.0)


def pixel_directions(record: dict[str, Any], u_px: Floats, v_px: Floats) -> tuple[Floats, Floats]:
    """Catalogue places of stars whose light falls on given places of a frame at mid-exposure.

    This is the inverse of the generator's own computation from the catalogue to the frame: places are ICRS with proper
    motion applied to the date, without parallax; light deflection, aberration, the Earth's rotation and refraction are
    removed. A rolling shutter's rows have their own attitude; the Earth's rotation while they are read (15 arcsec per
    second) is neglected.

    Parameters
    ----------
    record : dict
        The frame record.
    u_px, v_px : (n,) arrays

    Returns
    -------
    icrs : (n, 3) array
        Unit vectors; NaN if the lens has no direction.
    altitude_deg : (n,) array
        Apparent altitude; NaN if the lens has no direction or the place is outside the image circle.
    """
    rays, valid = _rays(record["camera"], u_px, v_px)
    circle = record["optics"]["image_circle_px"]
    if circle is not None:
        camera = record["camera"]
        valid &= np.hypot(u_px - camera["cx_px"], v_px - camera["cy_px"]) <= circle
    enu = np.einsum("nji,nj->ni", _attitudes(record, v_px), rays)
    place, time, air = record["site"], record["time"], record["atmosphere"]
    site = Site(place["latitude_deg"], place["longitude_deg"], place["height_m"])
    instant = Instant.parse(time["utc_mid"])
    orientation = EarthOrientation(time["ut1_utc_s"], time["polar_motion_x_arcsec"], time["polar_motion_y_arcsec"])
    pressure_hpa = air["pressure_hpa"] if air["refraction"] else 0.0
    around = Air(pressure_hpa, air["temperature_c"], air["relative_humidity"])
    to_icrs = icrs_from_enu(site, instant, orientation)
    icrs = np.full_like(enu, np.nan)
    rows = np.flatnonzero(valid)
    wanted = _without_refraction(enu[rows], site, around)
    guess = wanted @ to_icrs.T
    for _ in range(ROUNDS):
        miss = wanted - apparent_places(_catalogue(guess), site, instant, orientation, AIRLESS).enu
        guess += miss @ to_icrs.T
        guess /= np.linalg.norm(guess, axis=1, keepdims=True)
        if np.abs(miss).max(initial=0.0) < CLOSE_ENOUGH:
            break
    icrs[rows] = guess
    return icrs, np.where(valid, np.degrees(np.arctan2(enu[:, 2], np.hypot(enu[:, 0], enu[:, 1]))), np.nan)


def _without_refraction(enu: Floats, site: Site, air: Air) -> Floats:
    """Unit vectors (n, 3) of apparent directions lowered by their refraction."""
    level = np.hypot(enu[:, 0], enu[:, 1])
    altitude_deg = np.degrees(np.arctan2(enu[:, 2], level))
    drop = np.radians(refraction_of_apparent_deg(altitude_deg, air_around(site, air)))
    stretch = np.cos(drop) + enu[:, 2] * np.sin(drop) / np.maximum(level, 1e-300)
    return np.stack([stretch * enu[:, 0], stretch * enu[:, 1], enu[:, 2] * np.cos(drop) - level * np.sin(drop)], axis=1)


def _rays(camera: dict[str, Any], u_px: Floats, v_px: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Camera-frame unit vectors (n, 3) of places in the frame, and whether the lens images them."""
    mi = plugins.start()
    import drjit as dr

    from generator.plugins.lens import make_lens

    number: Any = dr.float64_array_t(mi.Float)
    projection = Projection(
        camera["model"], camera["f_px"], camera["fy_px"], camera["cx_px"], camera["cy_px"],
        tuple(camera["k"]), tuple(camera["p"]), tuple(camera.get("s", ())), tuple(camera.get("tilt_rad", ())),
    )  # fmt: skip
    # Opaque numbers, so that one kernel serves the lenses of all frames.
    lens = make_lens(projection, lambda value: dr.opaque(number, value))
    *ray, valid = lens.unproject(number(u_px), number(v_px))
    return np.stack([np.array(part) for part in ray], axis=1), np.array(valid)


def _attitudes(record: dict[str, Any], v_px: Floats) -> Floats:
    """Attitudes, ENU to camera, (n, 3, 3), when the rows of given places are half exposed."""
    attitude, sensor, time = record["attitude"], record["sensor"], record["time"]
    samples = np.array(attitude["sample_R_cam"], dtype=np.float64)
    if len(samples) == 1 or sensor["readout_direction"] is None:
        return np.broadcast_to(np.array(attitude["R_cam"], dtype=np.float64), (len(v_px), 3, 3))
    row = np.clip(np.rint(v_px), 0, record["camera"]["height"] - 1)
    if sensor["readout_direction"] == "up":
        row = record["camera"]["height"] - 1 - row
    follow = Slerp(np.array(attitude["sample_time_s"]), Rotation.from_matrix(samples))
    moments = time["exposure_s"] / 2 + row * sensor["line_time_s"]
    return np.asarray(follow(np.clip(moments, attitude["sample_time_s"][0], attitude["sample_time_s"][-1])).as_matrix())


def _catalogue(icrs: Floats) -> StarCatalogue:
    """Stars without motion or parallax in given directions."""
    nothing, numbers = np.zeros(len(icrs)), np.zeros(len(icrs), np.int32)
    ra_deg = np.degrees(np.arctan2(icrs[:, 1], icrs[:, 0]))
    dec_deg = np.degrees(np.arctan2(icrs[:, 2], np.hypot(icrs[:, 0], icrs[:, 1])))
    return StarCatalogue(
        hip=numbers,
        hr=numbers,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        pm_ra_mas_yr=nothing,
        pm_dec_mas_yr=nothing,
        parallax_mas=nothing,
        v_mag=nothing,
        bv_mag=nothing,
        vi_mag=nothing,
        bv_assumed=numbers.astype(bool),
        other_id=numbers,
    )
