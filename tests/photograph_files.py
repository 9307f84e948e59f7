"""Stand-ins for photographs: stars at their places over a known site, as files of cameras."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tifffile
from astropy.io import fits
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

import celnav
from benchmark.importing.known_sky import known_sky
from benchmark.place import Place

PLACE = Place(52.0, 4.36, 10.0)
UTC_START, EXPOSURE_S = "2020-01-15T20:00:00", 10.0
UTC_MID = "2020-01-15T20:00:05Z"
CAMERA = celnav.Camera.pinhole(480, 360, 60.0)
MOUNT = celnav.Attitude.zenith_north_up()
R_MOUNT = np.array(MOUNT.rows)
WANDER_DEG = 0.05
"""How far the camera is turned from its mount's attitude, about east."""
SKY_DN, NOISE_DN = 400.0, 6.0


def true_attitude() -> NDArray[np.float64]:
    """The attitude of the stand-ins, ENU to camera."""
    return np.asarray(R_MOUNT @ Rotation.from_rotvec([WANDER_DEG, 0, 0], degrees=True).as_matrix())


def standin(utc_mid: str = UTC_MID, seed: int = 1) -> NDArray[np.uint16]:
    """A photograph, DN: stars to V 7 with Gaussian images over a noisy sky."""
    sky = known_sky(PLACE, utc_mid, EXPOSURE_S)
    uv = CAMERA.project(sky.middle.enu @ true_attitude().T)
    image = np.random.default_rng(seed).normal(SKY_DN, NOISE_DN, (CAMERA.height, CAMERA.width))
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    for (x, y), magnitude in zip(uv, sky.stars.v_mag, strict=True):
        if np.isfinite(x) and -4 < x < CAMERA.width + 4 and -4 < y < CAMERA.height + 4:
            near = (slice(max(int(y) - 8, 0), int(y) + 9), slice(max(int(x) - 8, 0), int(x) + 9))
            spread = ((u[near] - x) ** 2 + (v[near] - y) ** 2) / (2 * 0.9**2)
            image[near] += 2e4 * 10 ** (-0.4 * magnitude) * np.exp(-spread)
    return np.clip(np.rint(image), 0, 65535).astype(np.uint16)


def write_fits(path: Path, pixels: NDArray[np.generic] | None = None, **header: object) -> Path:
    """A FITS photograph with its time."""
    unit = fits.PrimaryHDU(standin() if pixels is None else pixels)
    unit.header.update(
        {"DATE-OBS": UTC_START, "EXPTIME": EXPOSURE_S} | {k.replace("_", "-"): v for k, v in header.items()}
    )
    unit.writeto(path, overwrite=True)
    return path


def write_jpeg(path: Path, taken: str | None, offset: str | None = None, exposure_s: float | None = EXPOSURE_S) -> Path:
    """A colour photograph of 8 bits with EXIF tags."""
    grey = np.clip(standin() // 4, 0, 255).astype(np.uint8)
    exif = Image.Exif()
    photo = exif.get_ifd(0x8769)
    for tag, value in ((0x9003, taken), (0x9011, offset), (0x829A, exposure_s)):
        if value is not None:
            photo[tag] = value
    Image.fromarray(np.repeat(grey[:, :, None], 3, axis=2)).save(path, format="JPEG", quality=95, exif=exif)
    return path


def write_camera(path: Path, tilt_sigma_deg: float = 0.05, attitude: bool = True) -> Path:
    """A camera's file as `celnav calibrate` writes it."""
    content = {"camera": CAMERA.to_dict()}
    if attitude:
        content["attitude"] = {
            "R_cam": R_MOUNT.tolist(),
            "tilt_sigma_deg": tilt_sigma_deg,
            "heading_sigma_deg": tilt_sigma_deg,
        }
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def write_dng(path: Path, mosaic: NDArray[np.uint16], more: Sequence[tuple[object, ...]] = ()) -> Path:
    """A raw file: a mosaic red, green / green, blue of 12 bits (Adobe, DNG specification 1.4), with more tags."""
    diagonal = [part for row in np.eye(3, dtype=int).ravel() for part in (int(row), 1)]
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, (0, 1, 1, 2), True),  # CFAPattern
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50707, "B", 4, (1, 1, 0, 0), True),  # DNGBackwardVersion
        (50708, "s", 5, "test", True),  # UniqueCameraModel
        (50717, "I", 1, 4095, True),  # WhiteLevel
        (50721, "2i", 9, tuple(diagonal), True),  # ColorMatrix1
        *more,
    ]
    tifffile.imwrite(path, mosaic, photometric="CFA", metadata=None, extratags=tags)
    return path


def write_ff(folder: Path, name: str, mean: NDArray[np.uint8]) -> Path:
    """An FF file of a meteor station: four pictures of a block of 256 frames of video."""
    first = fits.PrimaryHDU()
    first.header.update(
        {
            "NROWS": mean.shape[0],
            "NCOLS": mean.shape[1],
            "NBITS": 8,
            "NFRAMES": 256,
            "FIRST": 0,
            "CAMNO": "XX0001",
            "FPS": 25.0,
        }
    )
    other = np.zeros_like(mean)
    parts = (("MAXPIXEL", mean), ("MAXFRAME", other), ("AVEPIXEL", mean), ("STDPIXEL", other))
    stream = io.BytesIO()
    fits.HDUList([first, *(fits.ImageHDU(picture, name=part) for part, picture in parts)]).writeto(stream)
    path = folder / name
    path.write_bytes(stream.getvalue())
    return path
