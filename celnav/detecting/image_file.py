"""Reading image files, strictly: a file that is damaged or absurdly large is refused."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from celnav.errors import ImageError

# A hundred million pixels: beyond any night-sky camera, and less than 1 GB while it is worked on.
MAX_PIXELS = 100_000_000
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
