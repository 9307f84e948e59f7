"""Reader of raw camera files (DNG and makers' formats), by LibRaw: the mosaic as the sensor recorded it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import PhotographError
from generator.reading.record import LARGEST_SIDE_PX

MOST_PIXELS = 100_000_000


@dataclass(frozen=True, eq=False)
class Mosaic:
    """Pixels of a raw file.

    Attributes
    ----------
    pixels : (height, width) uint16 array
        DN of the visible part, one colour per pixel.
    bits : int
    white : int
        DN from which a pixel is full.
    pattern : str or None
        Colours of the first 2 x 2 pixels, row by row; None for a sensor without colours.
    """

    pixels: NDArray[np.uint16]
    bits: int
    white: int
    pattern: str | None


def read_raw(path: Path) -> Mosaic:
    """Read a raw file's mosaic.

    Raises
    ------
    PhotographError
        rawpy is not installed, or the file is damaged, too large, or not a mosaic of 2 x 2 colours.
    """
    try:
        import rawpy
    except ImportError:
        raise PhotographError(
            f"{path}: a raw file, which needs rawpy: pip install 'skybench[raw]'; or develop it to a 16-bit TIFF without "
            "corrections of the lens and without cropping"
        ) from None
    try:
        with rawpy.imread(str(path)) as raw:
            sizes = raw.sizes
            if sizes.raw_width * sizes.raw_height > MOST_PIXELS or max(sizes.width, sizes.height) > LARGEST_SIDE_PX:
                raise PhotographError(
                    f"{path}: {sizes.raw_width} x {sizes.raw_height} px; at most {MOST_PIXELS} are read"
                )
            colours = raw.raw_pattern
            pattern = None
            if colours is not None:
                names = raw.color_desc.decode("ascii", "replace")
                if colours.shape != (2, 2):
                    raise PhotographError(
                        f"{path}: its mosaic of {colours.shape} colours is none of 2 x 2; develop it first"
                    )
                pattern = "".join(names[number] for number in colours.ravel())
            pixels = np.array(raw.raw_image_visible, dtype=np.uint16)
            white = int(raw.white_level or pixels.max())
    except rawpy.LibRawError as error:
        words = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise PhotographError(f"{path}: not a readable raw file ({words})") from error
    if pixels.ndim != 2:
        raise PhotographError(f"{path}: holds no mosaic but a picture in colours; develop it to a TIFF first")
    return Mosaic(pixels, max(8, white.bit_length()), white, pattern)
