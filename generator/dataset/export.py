"""`skybench export`: a dataset as plain files, COCO keypoints, FITS with a world coordinate system, or without its truth."""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs.utils import fit_wcs_from_points

from generator.dataset.archive import StoredFrame
from generator.dataset.images import decode
from generator.dataset.reader import Dataset
from generator.errors import GeneratorError
from generator.files import atomic_path, path_within, write_bytes
from generator.frame.render import png_bytes

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
BOX_HALF_WIDTH_SIGMAS = 3.0
"""Standard deviations of the point spread function from a star to the edges of its box."""

PUBLIC_KEYS = ("format", "time", "camera", "attitude", "optics", "sensor")
"""Parts of the frame record that a solver may know."""
PUBLIC_TIME_KEYS = ("utc_start", "utc_mid", "exposure_s")
PUBLIC_AIR_KEYS = ("pressure_hpa", "temperature_c", "refraction")

Progress = Callable[[str], None]


def export_files(dataset: Dataset, out: Path, progress: Progress) -> None:
    """Write every member of the shards as a file, and each table as one Parquet file."""
    for frame in dataset.stored_frames():
        for suffix, data in frame.members.items():
            write_bytes(path_within(out, f"{frame.frame_id}.{suffix}"), data)
        progress(frame.frame_id)
    for name, table in (("frames", dataset.frames()), ("stars", dataset.stars()), ("objects", dataset.objects())):
        with atomic_path(path_within(out, f"{name}.parquet")) as temporary:
            table.to_pandas().to_parquet(temporary)


def export_coco(dataset: Dataset, out: Path, progress: Progress) -> None:
    """Write PNG images and ``annotations.json``: each star a keypoint with a box of three sigma around it.

    COCO measures from the image's corner, half a pixel left of and above the first pixel's centre.
    """
    stars = dict(iter(dataset.stars().to_pandas().groupby("index")))
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for frame in dataset.stored_frames():
        record = json.loads(frame.members["json"])
        _write_png(out, frame, dataset.manifest.codec)
        index, camera = record["index"], record["camera"]
        images.append(
            {"id": index, "file_name": f"{frame.frame_id}.png", "width": camera["width"], "height": camera["height"]}
        )
        half = BOX_HALF_WIDTH_SIGMAS * record["optics"]["psf_sigma_px"]
        rows = stars.get(index)
        if rows is not None:
            for star in rows[rows["fraction_in_frame"] > 0.5].itertuples():
                x, y = star.u_px + 0.5, star.v_px + 0.5
                annotations.append(
                    {
                        "id": len(annotations) + 1,
                        "image_id": index,
                        "category_id": 1,
                        "keypoints": [x, y, 2],
                        "num_keypoints": 1,
                        "bbox": [x - half, y - half, 2 * half, 2 * half],
                        "area": 4 * half * half,
                        "iscrowd": 0,
                        "star_id": int(star.star_id),
                        "v_mag": float(star.v_mag),
                        "snr": float(star.snr),
                    }
                )
        progress(frame.frame_id)
    content = {
        "info": {"description": dataset.manifest.scenario, "version": dataset.manifest.skybench},
        "categories": [{"id": 1, "name": "star", "keypoints": ["centre"], "skeleton": []}],
        "images": images,
        "annotations": annotations,
    }
    write_bytes(out / "annotations.json", json.dumps(content).encode())


def export_fits(dataset: Dataset, out: Path, progress: Progress) -> None:
    """Write one FITS image a frame, with a TAN-SIP world coordinate system fitted to the truth.

    The system maps pixels to ICRS places of the stars, so that refraction and aberration are part of it. It is left out,
    and the header's keyword WCSFIT gives the reason, if the field is too wide for a gnomonic projection, has too few stars,
    or if the residual of the fit exceeds LARGEST_WCS_RESIDUAL_PX.
    """
    stars = dict(iter(dataset.stars().to_pandas().groupby("index")))
    for frame in dataset.stored_frames():
        record = json.loads(frame.members["json"])
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
        rows = stars.get(record["index"])
        header.update(_world_coordinates(rows, record["camera"]))
        image = decode(frame.members[dataset.manifest.codec], dataset.manifest.codec)
        with atomic_path(path_within(out, f"{frame.frame_id}.fits")) as temporary:
            # FITS counts lines from the bottom; the image is stored as it is, top line first, and the system fits it so.
            fits.PrimaryHDU(image, header).writeto(temporary, overwrite=True)
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


def export_withheld(dataset: Dataset, out: Path, progress: Progress) -> None:
    """Write images and the inputs of a solver under names that reveal nothing; truth and scenario are left out.

    Frames are named by a keyed hash of their index, whose key is the hash of the scenario, known only to its owner; they
    are listed in the order of these names.
    """
    entries = []
    for frame in dataset.stored_frames():
        record = json.loads(frame.members["json"])
        name = withheld_name(dataset.manifest.scenario_sha256, record["index"])
        public = {key: record[key] for key in PUBLIC_KEYS} | {"frame_id": name}
        public["time"] = {key: record["time"][key] for key in PUBLIC_TIME_KEYS}
        public["atmosphere"] = {key: record["atmosphere"][key] for key in PUBLIC_AIR_KEYS}
        image = png_bytes(decode(frame.members[dataset.manifest.codec], dataset.manifest.codec))
        write_bytes(path_within(out, f"{name}.png"), image)
        write_bytes(path_within(out, f"{name}.json"), (json.dumps(public, indent=1) + "\n").encode())
        entries.append({"frame_id": name, "sha256": hashlib.sha256(image).hexdigest()})
        progress(frame.frame_id)
    listing = sorted(entries, key=lambda entry: entry["frame_id"])
    write_bytes(out / "frames.json", (json.dumps(listing, indent=1) + "\n").encode())


def withheld_name(scenario_sha256: str, index: int) -> str:
    """Name of frame `index` in a copy without truth (HMAC-SHA-256, RFC 2104)."""
    return "test-" + hmac.new(scenario_sha256.encode(), str(index).encode(), hashlib.sha256).hexdigest()[:16]


def _write_png(out: Path, frame: StoredFrame, codec: str) -> None:
    data = frame.members[codec]
    write_bytes(path_within(out, f"{frame.frame_id}.png"), data if codec == "png" else png_bytes(decode(data, codec)))


EXPORTS: dict[str, Callable[[Dataset, Path, Progress], None]] = {
    "files": export_files,
    "coco": export_coco,
    "fits": export_fits,
    "withheld": export_withheld,
}


def export(folder: Path, kind: str, out: Path, progress: Progress = lambda frame_id: None) -> None:
    """Export a finished dataset.

    Parameters
    ----------
    folder : Path
        The dataset.
    kind : str
        One of EXPORTS.
    out : Path
        An empty or new folder.

    Raises
    ------
    GeneratorError
        Unknown kind, unfinished dataset, or a folder that cannot be used.
    """
    if kind not in EXPORTS:
        raise GeneratorError(f"--to {kind}: one of {', '.join(EXPORTS)}")
    dataset = Dataset.open(folder)
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise GeneratorError(f"{out}: is not empty; choose another folder")
        EXPORTS[kind](dataset, out, progress)
    except OSError as error:
        raise GeneratorError(
            f"{error.filename or out}: writing failed ({error.strerror}); choose another folder"
        ) from error
