"""Reading of calibration frames: images with their times, and the centroids of RMS' recalibrated platepars."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.frames import CalibrationFrame
from celnav.calibrating.sky_mask import sky_mask
from celnav.checking import finite_number
from celnav.command.exif import read_tags
from celnav.command.exposure_time import Stamp, exposure_time, refuse_clock_options
from celnav.detection import DetectionConfig, detect
from celnav.detections import Detections
from celnav.errors import CalibrationError, ImageError, TimeError
from celnav.reading.fits_file import is_fits, read_fits
from celnav.reading.image_file import read_image, refuse_raw, without_blanks
from celnav.sky.fits_times import block_middle
from celnav.sky.utc import parse_utc

MAX_BYTES = 200_000_000
MAX_FRAMES = 2000
MAX_STARS = 100_000
# A block of RMS consists of 256 video frames at 25 per second.
_BLOCK_S = 10.24
_FEWEST_NAMED = 20
# Least and largest number of images from which a mask is learnt.
FEWEST_FOR_MASK, _MOST_FOR_MASK = 5, 12


def read_frames(
    paths: Sequence[str],
    utc: Sequence[str] | None = None,
    time_zone: str | None = None,
    stamp: Stamp = "start",
    mask: NDArray[np.bool_] | None = None,
    star_sigma_px: float | None = None,
) -> list[CalibrationFrame]:
    """Read images and detect their stars; or read a file of centroids.

    Parameters
    ----------
    paths : sequence of str
        Images; a ``platepars_all_recalibrated.json`` of RMS stands for all of its frames that RMS recalibrated.
    utc : sequence of str, optional
        Middle of each exposure, in the order of the images; otherwise taken from the FITS header, the frame record next to
        the image (same name, ``.json``), or the EXIF tags.
    time_zone, stamp
        Interpretation of EXIF times, as for ``celnav solve``.
    mask : ndarray of bool, optional
        Pixels that are not used; without it, a mask is learnt if there are five or more images (`celnav.sky_mask`).
    star_sigma_px : float, optional
        Standard deviation of the star images; measured unless given.
    """
    if utc is not None and len(utc) != len(paths):
        raise TimeError(f"--utc is given {len(utc)} times for {len(paths)} frames: give one for each, in their order")
    frames: list[CalibrationFrame] = []
    config = DetectionConfig(psf_sigma_px=star_sigma_px)
    if mask is None:
        mask = learnt_mask(paths)
    for number, path in enumerate(paths):
        if Path(path).suffix.lower() == ".json":
            frames += read_rms_centroids(path)
        else:
            frames.append(_image_frame(path, None if utc is None else utc[number], time_zone, stamp, mask, config))
        if len(frames) > MAX_FRAMES:
            raise CalibrationError(f"more than {MAX_FRAMES} frames: choose some of them")
    return frames


def _image_frame(
    path: str,
    utc: str | None,
    time_zone: str | None,
    stamp: Stamp,
    mask: NDArray[np.bool_] | None,
    config: DetectionConfig,
) -> CalibrationFrame:
    image, middle, exposure_s = image_and_time(path)
    refuse_clock_options(path, time_zone, stamp)
    moment = utc or middle
    if moment is None:
        if is_fits(path):
            raise TimeError(f"image {path}: {read_fits(path).exposure.lacks}: give --utc, once for each image")
        try:
            moment = exposure_time(read_tags(path), None, time_zone, stamp).utc
        except TimeError as error:
            raise TimeError(f"image {path}: {error}") from None
    image, mask = without_blanks(image, mask)
    height, width = image.shape[:2]
    try:
        detections = detect(image, mask, config)
    except ImageError as error:
        raise ImageError(f"image {path}: {error}") from None
    return CalibrationFrame(detections, parse_utc(moment), (width, height), Path(path).name, exposure_s)


def image_and_time(path: str) -> tuple[NDArray[np.generic], str | None, float | None]:
    """Return the pixels, and middle and duration (s) of the exposure if header, frame record or tags state them."""
    refuse_raw(path)
    if is_fits(path):
        found = read_fits(path)
        middle = found.exposure.middle
        return found.pixels, None if middle is None else _written(middle), found.exposure.length_s
    stated, exposure_s = _of_record(Path(path).with_suffix(".json"))
    return read_image(path), stated, read_tags(path).exposure_s if exposure_s is None else exposure_s


def first_shape(paths: Sequence[str]) -> tuple[int, ...] | None:
    """Return the shape of the first image; None if there are only files of centroids."""
    first = next((path for path in paths if Path(path).suffix.lower() != ".json"), None)
    return None if first is None else image_and_time(first)[0].shape


def learnt_mask(paths: Sequence[str]) -> NDArray[np.bool_] | None:
    """Learn a mask from up to twelve images spread over all; None if they are few or their sky has not turned."""
    paths = [path for path in paths if Path(path).suffix.lower() != ".json"]
    if len(paths) < FEWEST_FOR_MASK:
        return None
    rows = np.unique(np.linspace(0, len(paths) - 1, min(len(paths), _MOST_FOR_MASK)).astype(int))
    try:
        return sky_mask([without_blanks(image_and_time(paths[row])[0], None)[0] for row in rows])
    except ImageError:
        return None


def _written(moment: datetime) -> str:
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _of_record(path: Path) -> tuple[str | None, float | None]:
    """Return middle and duration (s) of the exposure from the frame record next to an image; None if not stated."""
    try:
        record = json.loads(path.read_text(encoding="utf-8")) if path.stat().st_size <= MAX_BYTES else None
    except (OSError, ValueError, RecursionError):
        return None, None
    time = record.get("time") if isinstance(record, dict) else None
    middle = time.get("utc_mid") if isinstance(time, dict) else None
    length = time.get("exposure_s") if isinstance(time, dict) else None
    known = isinstance(length, (int, float)) and not isinstance(length, bool) and 0 < length < math.inf
    return (middle if isinstance(middle, str) else None), (float(length) if known and length is not None else None)


def read_rms_centroids(path: str | Path) -> list[CalibrationFrame]:
    """Read ``platepars_all_recalibrated.json``: the centroids of each frame that RMS recalibrated.

    The identifications and poses from RMS are not used. Rows of ``star_list`` are Julian date, row, column, intensity, right
    ascension, declination, magnitude. Frames with fewer than 20 stars are left out.
    """
    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise CalibrationError(f"{path} is larger than {MAX_BYTES // 1_000_000} MB")
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path} is not JSON: {error}") from None
    if not isinstance(content, dict) or not all(isinstance(value, dict) for value in content.values()):
        raise CalibrationError(f"{path} must hold platepars by the names of their frames, as RMS writes them")
    frames = []
    for name, platepar in sorted(content.items()):
        if platepar.get("auto_recalibrated") and len(platepar.get("star_list") or ()) >= _FEWEST_NAMED:
            frames.append(_rms_frame(path, name, platepar))
    if not frames:
        raise CalibrationError(f"{path} has no recalibrated frame with {_FEWEST_NAMED} stars or more in its star_list")
    return frames


def _rms_frame(path: str | Path, name: str, platepar: dict[str, Any]) -> CalibrationFrame:
    what = f"{path}: frame {name[:80]}"
    width, height = (
        int(finite_number(platepar.get(key), f"{what}: {key}", CalibrationError, 1, 100_000))
        for key in ("X_res", "Y_res")
    )
    try:
        rows = np.array(platepar["star_list"], dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.ndim != 2 or rows.shape[1] < 4 or len(rows) > MAX_STARS or not np.isfinite(rows[:, :4]).all():
        raise CalibrationError(f"{what}: star_list must be rows of Julian date, row, column, intensity, …")
    rows = rows[np.argsort(-rows[:, 3], kind="stable")]
    middle = block_middle(name, _BLOCK_S)
    if middle is None:
        # A Julian date in one double is accurate to 0.04 ms.
        days = finite_number(float(rows[0, 0]), f"{what}: Julian date", CalibrationError, 2_400_000, 2_600_000)
        middle = datetime(2000, 1, 1, 12, tzinfo=UTC) + timedelta(days=days - 2451545.0)
    detections = Detections(rows[:, [2, 1]].copy(), np.maximum(rows[:, 3], math.ulp(1.0)), (height, width), None)
    return CalibrationFrame(detections, parse_utc(_written(middle)), (width, height), name, _BLOCK_S)
