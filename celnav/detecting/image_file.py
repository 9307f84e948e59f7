"""Reading image files, strictly: one that is damaged or absurdly large is refused; and which of their pixels are used."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.errors import ImageError

Mask = NDArray[np.bool_]
Pixels = NDArray[np.generic]
# A hundred million pixels: beyond any night-sky camera, and less than 1 GB while it is worked on.
MAX_PIXELS = 100_000_000
# Progressive pictures have some ten; each scan of coefficients in its own bits makes less than a hundred.
_MOST_SCANS = 100
# In the data of a scan, 0xFF is followed by zero or a restart; else it begins a marker (ITU-T T.81, B.1.1).
_MARKER = re.compile(rb"\xff+[^\x00\xd0-\xd7\xff]")
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, 0xD9
_MODES = {"L", "I;16", "I;16L", "I;16B", "I", "F", "RGB", "RGBA", "LA", "P", "1"}


def read_image(path: str | Path) -> NDArray[np.generic]:
    """Read a PNG, JPEG, TIFF or HEIF image of 8 or 16 bits, or a FITS image, plain or compressed (gzip, bzip2).

    Parameters
    ----------
    path : str or Path
        File.

    Returns
    -------
    ndarray, shape (height, width) or (height, width, 3)
        Values as in the file.

    Raises
    ------
    ImageError
        When the file is missing, truncated, not an image, or has more than a hundred million pixels.
    """
    from PIL import Image, UnidentifiedImageError

    from celnav.detecting.fits_file import is_fits, read_fits
    from celnav.detecting.heif_file import decode, is_heif, open_heif

    if is_fits(path):
        return read_fits(path).pixels
    if is_heif(path):
        found = open_heif(path)
        _refuse_large(path, found.width, found.height)
        return decode(found, path)
    try:
        with warnings.catch_warnings():
            # The size is checked below, before any pixel is decoded.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=("PNG", "JPEG", "TIFF")) as image:
                _refuse_large(path, image.width, image.height)
                if image.mode not in _MODES:
                    raise ImageError(f"image {path} has the pixel format {image.mode}; save it as grey or RGB PNG")
                if image.format == "JPEG":
                    _refuse_scans(path)
                image.load()
                converted = image.convert("RGB") if image.mode in ("RGBA", "P", "LA") else image
                return np.array(converted.convert("L") if image.mode == "1" else converted)
    except ImageError:
        raise
    except FileNotFoundError:
        raise ImageError(f"image {path} does not exist") from None
    except UnidentifiedImageError:
        raise ImageError(f"image {path} is not a PNG, JPEG, TIFF or HEIF image") from None
    except Image.DecompressionBombError:
        raise ImageError(f"image {path} has too many pixels; the limit is 100 million") from None
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise ImageError(f"image {path} is damaged or cannot be read: {error}".replace("\n", " ")) from None


def _refuse_large(path: str | Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise ImageError(f"image {path} has {width} x {height} pixels; the limit is 100 million")


def _refuse_scans(path: str | Path) -> None:
    """Refuse a JPEG of more scans than any program writes: each of them costs a pass over all pixels."""
    data, place = Path(path).read_bytes(), 2
    for _ in range(_MOST_SCANS + 1):
        # Segments up to the next scan, whose length they state.
        while (marker := _MARKER.search(data, place)) and data[marker.end() - 1] != _START_OF_SCAN:
            if data[marker.end() - 1] == _END_OF_IMAGE:
                return
            place = marker.end() + max(2, int.from_bytes(data[marker.end() : marker.end() + 2], "big"))
        if marker is None:
            return
        place = marker.end()
    raise ImageError(f"image {path} has more than {_MOST_SCANS} scans: save it anew")


def read_mask(path: str, shape: tuple[int, ...] | None = None) -> Mask:
    """Read a picture that is not black where pixels are not to be used.

    Raises
    ------
    ImageError
        When it cannot be read, is not of the image's shape where that is given, or hides everything.
    """
    values = read_image(path)
    hidden: Mask = np.asarray(values.astype(bool) if values.ndim == 2 else values.any(axis=2), dtype=np.bool_)
    if hidden.all():
        raise ImageError(f"--mask {path} hides every pixel: it must be black where the image is to be used")
    if shape is not None and hidden.shape != shape[:2]:
        sizes = [f"{width} x {height}" for height, width in (hidden.shape, shape[:2])]
        raise ImageError(f"--mask {path} has {sizes[0]} px, the image {sizes[1]}: give one of the image's size")
    return hidden


def without_blanks(image: Pixels, mask: Mask | None) -> tuple[Pixels, Mask | None]:
    """Hide the pixels of an image of floating numbers that have no value (NaN), as FITS marks what was not measured.

    Parameters
    ----------
    image : ndarray, shape (height, width) or (height, width, 3)
    mask : ndarray of bool, shape (height, width), optional
        True where pixels are not used.

    Returns
    -------
    image, mask
        With the median in the hidden pixels; as they were where every pixel has a value.
    """
    values: NDArray[Any] = image
    if not np.issubdtype(values.dtype, np.floating):
        return image, mask
    blank = np.isnan(values)
    if not blank.any() or blank.all():
        return image, mask
    hidden: Mask = blank if blank.ndim == 2 else blank.any(axis=2)
    filled = np.where(blank, np.nanmedian(values), values)
    if mask is not None and mask.shape == hidden.shape:
        hidden = hidden | mask
    return filled, hidden if mask is None or mask.shape == hidden.shape else mask
