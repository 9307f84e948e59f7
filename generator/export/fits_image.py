"""A dataset as FITS images with a world coordinate system, or a table of directions if no system describes the lens."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from generator.dataset.reader import Dataset, Frame
from generator.export.form import ExportOptions, Progress
from generator.export.pixel_directions import pixel_directions
from generator.export.sky_wcs import LARGEST_RESIDUAL_PX, SkyFit, equatorial_deg, fit_sky
from generator.files import atomic_path, path_within
from generator.sky.component import blas_threads

Floats = NDArray[np.float64]

DIRECTIONS = "DIRECTIONS"
"""Name of the extension with the table."""
LATTICE_PX, FINE_LATTICE_PX = 8, 4
"""Steps of the table's lattice; the finer one is for short focal lengths, because the error of linear interpolation is step^2
/ 8 f."""
SHORT_FOCAL_PX = 250.0
MEANING = (
    "World coordinates: ICRS place of date (proper motion applied, no parallax) of",
    "the star whose light falls on a pixel in mid-exposure. Light deflection,",
    "aberration, the Earth's rotation and refraction are part of the system.",
    "The first line of the image is its top: display it with the origin above.",
)


def export_fits(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write one FITS image per frame.

    The header's WCSFIT is ``SIP`` or ``linear`` for a system that agrees within LARGEST_RESIDUAL_PX with the generator's
    directions of pixels (WCSRES: largest distance, px), above the altitude WCSALT. If that is not the horizon, or if
    there is no such system (``none``), the extension DIRECTIONS contains the directions of a lattice of pixels.
    """
    del options
    # The fits are small, and threads would wait for each other.
    with blas_threads().limit(limits=1, user_api="blas"):
        for frame in dataset:
            with atomic_path(path_within(out, f"{frame.frame_id}.fits")) as temporary:
                fits_file(frame).writeto(temporary, overwrite=True)
            progress(frame.frame_id)


def fits_file(frame: Frame) -> fits.HDUList:
    """A frame's image with its header, and the table of directions if it is needed."""
    record = frame.record
    camera = record["camera"]
    header = _header(record)

    def directions(u_px: Floats, v_px: Floats) -> tuple[Floats, Floats]:
        return pixel_directions(record, u_px, v_px)

    centre = (float(camera["cx_px"]), float(camera["cy_px"]))
    found = fit_sky(directions, camera["model"], camera["width"], camera["height"], centre)
    good = found is not None and found.residual_px <= LARGEST_RESIDUAL_PX
    if found is not None and good:
        _describe(header, found)
    else:
        reason = "hardly any sky in the frame" if found is None else f"SIP leaves {found.residual_px:.2f} px"
        header["WCSFIT"] = ("none", reason)
    # Rows of the primary HDU are numbered upwards in FITS; the image is stored as it is, and the system is fitted
    # accordingly.
    parts: list[Any] = [fits.PrimaryHDU(frame.image, header)]
    if found is not None and (not good or found.lowest_altitude_deg > 0):
        parts.append(_table(record))
    return fits.HDUList(parts)


def _header(record: dict[str, Any]) -> fits.Header:
    """Cards of time, place and sensor."""
    time, site, sensor = record["time"], record["site"], record["sensor"]
    header = fits.Header()
    header["TIMESYS"] = "UTC"
    header["DATE-OBS"] = (time["utc_start"].rstrip("Z"), "exposure start")
    header["DATE-AVG"] = (time["utc_mid"].rstrip("Z"), "mid-exposure")
    header["EXPTIME"] = (time["exposure_s"], "s")
    header["SITELAT"] = (site["latitude_deg"], "deg, WGS84")
    header["SITELONG"] = (site["longitude_deg"], "deg, east positive")
    header["SITEELEV"] = (site["height_m"], "m")
    header["GAIN"] = (sensor["gain_e_per_dn"], "e/DN")
    header["BLKLEVEL"] = (sensor["black_level_dn"], "DN")
    if sensor["bayer_pattern"] is not None:
        header["BAYERPAT"] = (sensor["bayer_pattern"], "of the first 2 x 2 pixels, top line first")
    header["SCENARIO"] = (record["scenario"]["name"], "skybench scenario")
    header["FRAMEIDX"] = (record["index"], "index of the frame")
    return header


def _describe(header: fits.Header, found: SkyFit) -> None:
    header.update(found.header())
    header["WCSFIT"] = ("SIP" if found.order > 1 else "linear", f"polynomials of order {found.order}")
    header["WCSRES"] = (round(found.residual_px, 5), "largest distance from pixels' directions, px")
    header["WCSALT"] = (found.lowest_altitude_deg, "deg, lowest altitude for which WCSRES holds")
    for line in MEANING:
        header["COMMENT"] = line


def _table(record: dict[str, Any]) -> fits.BinTableHDU:
    """Directions of a lattice of pixels, row by row from the top; NaN beyond the lens or the sky."""
    camera = record["camera"]
    step = FINE_LATTICE_PX if camera["f_px"] < SHORT_FOCAL_PX else LATTICE_PX
    # The last places are on or beyond the last pixels, so that every pixel is between four of them.
    across, down = (np.arange(-(-(camera[side] - 1) // step) + 1) * float(step) for side in ("width", "height"))
    v, u = (axis.ravel() for axis in np.meshgrid(down, across, indexing="ij"))
    icrs, altitude_deg = pixel_directions(record, u, v)
    icrs[~(altitude_deg > record["sky"].get("horizon_altitude_deg", 0.0))] = np.nan
    ra_deg, dec_deg = equatorial_deg(icrs).T
    columns = [
        fits.Column("u_px", "E", unit="pixel", array=u),
        fits.Column("v_px", "E", unit="pixel", array=v),
        fits.Column("ra_deg", "D", unit="deg", array=ra_deg),
        fits.Column("dec_deg", "D", unit="deg", array=dec_deg),
        fits.Column("altitude_deg", "E", unit="deg", array=altitude_deg),
    ]
    table = fits.BinTableHDU.from_columns(columns, name=DIRECTIONS)
    table.header["NACROSS"] = (len(across), "places along u; u runs fastest")
    table.header["NDOWN"] = (len(down), "places along v")
    table.header["STEP"] = (step, "px between places, from 0")
    for line in MEANING[:3]:
        table.header["COMMENT"] = line
    return table
