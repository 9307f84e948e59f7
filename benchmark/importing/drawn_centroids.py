"""Pictures of measured centroids: frames of which only the stars' measured positions are kept, not the image.

RMS keeps the centroids of the stars that it found in every block of 256 video frames, but the images of only a few. A picture
with one round spot at each centroid, as bright as it was measured, is a frame that every solver can be given: positions and
light are those of the real sky, and a detector has nothing to do but to find the spots.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from benchmark.errors import PhotographError
from celnav.calibrating.frames import CalibrationFrame
from celnav.command.calibration_frames import MAX_BYTES, read_rms_centroids
from celnav.command.checks.input_files import check_file
from celnav.command.checks.rms_file import check_rms_file
from celnav.errors import CalibrationError, CelnavError
from celnav.reading.image_file import MAX_PIXELS
from generator.files import atomic_path
from generator.reading.record import LARGEST_SIDE_PX

Floats = NDArray[np.float64]

SPOT_SIGMA_PX = 1.2
"""Standard deviation of a spot along an axis: wide enough for a centroid to a hundredth of a pixel."""
DN_PER_UNIT = 40.0
"""Light of a spot per unit of RMS' intensity: 8-bit video becomes 16 bits."""
SKY_DN, NOISE_DN = 1000.0, 4.0
"""Even sky, and its noise, from which detectors take their limits."""
HALF_PX = 6
_MJD_EPOCH = datetime(1858, 11, 17, tzinfo=UTC)


def draw_centroids(platepars: Path, folder: Path, names: Sequence[str] | None = None) -> list[Path]:
    """Draw the centroids of a night of RMS, one FITS file for each frame with 20 stars or more, in the order of time.

    Parameters
    ----------
    platepars : Path
        ``platepars_all_recalibrated.json``.
    folder : Path
        Folder of the pictures.
    names : sequence of str, optional
        Names of the FF files whose centroids are drawn, in this order; by default all.

    Raises
    ------
    PhotographError
        The file has no such centroids, or a picture cannot be written.
    """
    try:
        frames = {frame.name: frame for frame in checked_centroids(platepars)}
    except CelnavError as error:
        raise PhotographError(str(error)) from error
    absent = [name for name in names or () if name not in frames]
    if absent:
        raise PhotographError(f"{platepars}: has no centroids of {absent[0]}")
    wanted = sorted(frames) if names is None else names
    for name in wanted:
        _check_size(platepars, frames[name])
    return [_written(frames[name], folder) for name in wanted]


def checked_centroids(platepars: Path) -> list[CalibrationFrame]:
    """Read a file of RMS' platepars from a third party. Raises CelnavError for one that cannot be used."""
    check_file(platepars, f"file of centroids {platepars}", CalibrationError, MAX_BYTES)
    check_rms_file(platepars)
    return read_rms_centroids(platepars)


def _check_size(platepars: Path, frame: CalibrationFrame) -> None:
    """Refuse a frame that would be a picture larger than any that is read again."""
    width, height = frame.size
    if max(width, height) > LARGEST_SIDE_PX or width * height > MAX_PIXELS:
        raise PhotographError(
            f"{platepars}: frame {frame.name[:80]}: X_res = {width} and Y_res = {height} must be at most {LARGEST_SIDE_PX} "
            f"pixels each, {MAX_PIXELS // 10**6} million together: mend them"
        )


def drawn(frame: CalibrationFrame) -> NDArray[np.uint16]:
    """Picture of a frame's centroids, (height, width) DN; the same centroids give the same bytes."""
    width, height = frame.size
    seed = int.from_bytes(hashlib.sha256(frame.name.encode()).digest()[:16], "little")
    picture = SKY_DN + np.random.default_rng(seed).normal(0.0, NOISE_DN, (height, width))
    flux = np.ones(len(frame.uv)) if frame.detections.flux is None else frame.detections.flux
    columns, rows = (np.rint(at).astype(np.intp)[:, None] + np.arange(-HALF_PX, HALF_PX + 1) for at in frame.uv.T)
    across, down = _shares(columns, frame.uv[:, 0]), _shares(rows, frame.uv[:, 1])
    light = DN_PER_UNIT * flux[:, None, None] * down[:, :, None] * across[:, None, :]
    row, column = np.broadcast_arrays(rows[:, :, None], columns[:, None, :])
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    np.add.at(picture, (row[inside], column[inside]), light[inside])
    # Last digits, which depend on the machine's arithmetic, must not decide how a value is rounded.
    return np.clip(np.rint(np.round(picture, 6)), 0, 65535).astype(np.uint16)


def _shares(pixels: NDArray[np.intp], middle: Floats) -> Floats:
    """Shares of the spots' light in their rows or columns of pixels, (n, m) for pixels (n, m) and middles (n,)."""
    edges = np.concatenate((pixels - 0.5, pixels[:, -1:] + 0.5), axis=1)
    return np.asarray(np.diff(ndtr((edges - middle[:, None]) / SPOT_SIGMA_PX), axis=1))


def _written(frame: CalibrationFrame, folder: Path) -> Path:
    """Write the picture of a frame as FITS, with the middle and the length of the exposure."""
    from astropy.io import fits

    middle = _MJD_EPOCH + timedelta(days=frame.utc.mjd_day, seconds=frame.utc.second_of_day_s)
    unit = fits.PrimaryHDU(drawn(frame))
    unit.header["DATE-AVG"] = middle.strftime("%Y-%m-%dT%H:%M:%S.%f")
    unit.header["TIMESYS"] = "UTC"
    unit.header["EXPTIME"] = frame.exposure_s
    path = folder / f"{Path(frame.name).name.partition('.')[0]}.centroids.fits"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            unit.writeto(temporary, overwrite=True)
    except OSError as error:
        raise PhotographError(f"{path}: cannot be written ({error.strerror})") from error
    return path
