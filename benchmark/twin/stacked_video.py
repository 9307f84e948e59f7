"""Photographs of meteor cameras: the stacks of 256 video frames that the Global Meteor Network keeps, named FF.

Format: Vida et al. 2021, MNRAS 506, 5046. The time is in the file's name, the place in the network's records; here the scene
states it.
"""

from __future__ import annotations

import datetime as dt
import io
import re
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import PhotographError

LARGEST_PX = 20_000_000
PICTURES = ("MAXPIXEL", "AVEPIXEL", "STDPIXEL")
_NAME = re.compile(r"FF_(?P<station>\w+?)_(?P<date>\d{8})_(?P<time>\d{6})_(?P<ms>\d{3})(_\d+)?\.fits(\.gz|\.bz2)?")


@dataclass(frozen=True, eq=False)
class StackedVideo:
    """A stack of 8-bit video frames, (height, width) arrays.

    Attributes
    ----------
    mean, maximum, deviation : float32 arrays
        Statistics of each pixel over the frames, DN.
    exposure_s : float
        Number of frames over their rate.
    """

    mean: NDArray[np.float32]
    maximum: NDArray[np.float32]
    deviation: NDArray[np.float32]
    exposure_s: float


def start_of(name: str) -> str | None:
    """Start in UTC (ISO 8601 with Z) that the name of an FF file states; None for other names and impossible times."""
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    try:
        start = dt.datetime.strptime(f"{match['date']}{match['time']}{match['ms']}000", "%Y%m%d%H%M%S%f")
    except ValueError:
        return None
    return f"{start.isoformat(timespec='milliseconds')}Z"


def read_stack(data: bytes, name: str) -> StackedVideo:
    """Read the pictures of an FF file from its uncompressed bytes.

    Raises
    ------
    PhotographError
        It is not a FITS file, lacks a picture or its numbers of frames, or has more than LARGEST_PX pixels.
    """
    from astropy.io import fits

    try:
        with (
            warnings.catch_warnings(),
            fits.open(io.BytesIO(data), memmap=False, disable_image_compression=True) as hdus,
        ):
            warnings.simplefilter("error")
            header = hdus[0].header
            frames, rate = header.get("NFRAMES"), header.get("FPS")
            sides = {tuple(hdus[part].header.get(f"NAXIS{axis}", 0) for axis in (1, 2)) for part in PICTURES}
            if len(sides) != 1 or not 0 < np.prod(next(iter(sides))) <= LARGEST_PX:
                raise PhotographError(f"{name}: expected pictures of one size and at most {LARGEST_PX} pixels")
            pictures = [np.asarray(hdus[part].data, dtype=np.float32) for part in PICTURES]
    except (OSError, ValueError, TypeError, KeyError, Warning, fits.VerifyError) as error:
        raise PhotographError(f"{name}: cannot be read as a stack of video ({str(error).splitlines()[0]})") from None
    if not all(isinstance(value, int | float) and 0 < value < 1e4 for value in (frames, rate)):
        raise PhotographError(f"{name}: its header lacks NFRAMES and FPS, the number of frames and their rate")
    maximum, mean, deviation = pictures
    return StackedVideo(mean, maximum, deviation, float(frames) / float(rate))
