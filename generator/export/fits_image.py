"""A dataset as FITS images with a world coordinate system."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs.utils import fit_wcs_from_points

from generator.dataset.reader import Dataset
from generator.export.form import ExportOptions, Progress
from generator.files import atomic_path, path_within

SIP_DEGREE = 3
"""Highest order of the distortion polynomials; the leading radial distortion of a lens is cubic."""
TANGENT_ROUNDS = 5
"""Fits that bring the tangent point to the principal point."""
LARGEST_WCS_RESIDUAL_PX = 0.5
"""Rms beyond which a world coordinate system would mislead more than help."""
FEWEST_WCS_STARS = 60
"""Three for each of the 20 numbers of the fit."""
WIDEST_WCS_FIELD_DEG = 130.0
"""Diagonal; at its corners a gnomonic projection is stretched by a factor of 5.6 in radius."""


def export_fits(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write one FITS image a frame, with a TAN-SIP world coordinate system fitted to the truth.

    The system maps pixels to ICRS places of the stars, so that refraction and aberration are part of it. It is left out,
    and the header's keyword WCSFIT gives the reason, if the field is too wide for a gnomonic projection, has too few stars,
    or if the residual of the fit exceeds LARGEST_WCS_RESIDUAL_PX.
    """
    del options
    for frame in dataset:
        record = frame.record
        header = fits.Header()
        header["DATE-OBS"] = (record["time"]["utc_start"].rstrip("Z"), "UTC, exposure start")
        header["EXPTIME"] = (record["time"]["exposure_s"], "s")
        header["SITELAT"] = (record["site"]["latitude_deg"], "deg, WGS84")
        header["SITELONG"] = (record["site"]["longitude_deg"], "deg, east positive")
        header["SITEELEV"] = (record["site"]["height_m"], "m")
        header["GAIN"] = (record["sensor"]["gain_e_per_dn"], "e/DN")
        header["BLKLEVEL"] = (record["sensor"]["black_level_dn"], "DN")
        header["SCENARIO"] = (dataset.manifest.scenario, "skybench scenario")
        header["FRAMEIDX"] = (record["index"], "index of the frame")
        header.update(_world_coordinates(frame.stars.to_pandas(), record["camera"]))
        with atomic_path(path_within(out, f"{frame.frame_id}.fits")) as temporary:
            # FITS counts lines from the bottom; the image is stored as it is, top line first, and the system fits it so.
            fits.PrimaryHDU(frame.image, header).writeto(temporary, overwrite=True)
        progress(frame.frame_id)


def _world_coordinates(stars: pd.DataFrame | None, camera: dict[str, Any]) -> fits.Header:
    """Header cards of a fitted TAN-SIP system, or the reason why there is none."""
    header = fits.Header()
    if stars is not None:
        stars = (
            stars[(stars["fraction_in_frame"] > 0.99) & (stars["altitude_deg"] > 15)].sort_values("v_mag").head(2000)
        )
    if stars is None or len(stars) < FEWEST_WCS_STARS:
        header["WCSFIT"] = ("none", "too few stars in the field")
        return header
    corner = np.hypot(camera["width"], camera["height"]) / 2 / camera["f_px"]
    if camera["model"] not in ("pinhole", "brown_conrady") or 2 * np.degrees(np.arctan(corner)) > WIDEST_WCS_FIELD_DEG:
        header["WCSFIT"] = ("none", "the field is too wide for TAN-SIP")
        return header
    pixels = (stars["u_px"].to_numpy(), stars["v_px"].to_numpy())
    places = SkyCoord(stars["ra_deg"].to_numpy() * u.deg, stars["dec_deg"].to_numpy() * u.deg)
    # The tangent point must lie at the principal point; otherwise the distortion terms would have to absorb the offset.
    tangent: Any = "center"
    for _ in range(TANGENT_ROUNDS):
        system = fit_wcs_from_points(pixels, places, proj_point=tangent)
        tangent = system.pixel_to_world(camera["cx_px"], camera["cy_px"])
    system = fit_wcs_from_points(pixels, places, proj_point=tangent, sip_degree=SIP_DEGREE)
    apart = system.pixel_to_world(*pixels).separation(places).to_value(u.rad)
    residual = float(np.sqrt(np.mean(apart**2))) * camera["f_px"]
    if not residual < LARGEST_WCS_RESIDUAL_PX:
        header["WCSFIT"] = ("none", f"TAN-SIP leaves {residual:.2f} px")
        return header
    header.update(system.to_header(relax=True))
    header["WCSFIT"] = (round(residual, 5), "rms of the fit, px")
    return header
