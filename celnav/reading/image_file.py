"""Strict reading of image files, which refuses damaged or absurdly large ones, and of masks of their pixels."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celnav.errors import ImageError

if TYPE_CHECKING:
    from PIL.Image import Image

Mask = NDArray[np.bool_]
Pixels = NDArray[np.generic]
# A hundred million pixels are more than any night-sky camera has, and take less than 1 GB during processing.
MAX_PIXELS = 100_000_000
# Samples per pixel for the PNG colour types that have more than one.
_PNG_SAMPLES = {2: 3, 4: 2, 6: 4}
_TIFF_BITS, _TIFF_ORIENTATION, _TIFF_SAMPLES, _TIFF_PLANES = 258, 274, 277, 284
# Largest accepted file size: this multiple of the size of its pixels, plus this many bytes of tags and profiles.
_MOST_OVERHEAD, _MOST_TAGS = 2, 64_000_000
# Largest number of scans in a JPEG. Progressive pictures have some ten; even one scan per coefficient bit gives fewer than
# a hundred.
_MOST_SCANS = 100
# Largest number of segments between them, each of which takes time; profiles and previews have some hundred.
_MOST_SEGMENTS = 20_000
# Markers that begin a segment, a scan or the end (ITU-T T.81, B.1.1). Others have no length: restarts, 0xFF 0x01, and 0xFF
# before zero, which is a value of a scan; of a run of 0xFF the last one counts, so that the search is linear.
_MARKER = re.compile(rb"\xff[\xc0-\xcf\xd9-\xef\xfe]")
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, 0xD9
RAW_SUFFIXES = {
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".iiq", ".kdc", ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf",
    ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
}  # fmt: skip
_MODES = {"L", "I;16", "I;16L", "I;16B", "I", "F", "RGB", "RGBA", "LA", "P", "1"}


def refuse_raw(path: str | Path) -> None:
    """Raise `ImageError` for a raw file, of which many programs would only open the small preview."""
    suffix = Path(path).suffix.lower()
    if suffix in RAW_SUFFIXES:
        raise ImageError(
            f"image {path} is a raw file ({suffix}): develop it to a 16-bit TIFF or PNG first, without corrections of the "
            "lens and without cropping"
        )


def read_image(path: str | Path) -> NDArray[np.generic]:
    """Read a PNG, JPEG, TIFF or HEIF image of 8 or 16 bits, or a FITS image, plain or compressed (gzip, bzip2).

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    ndarray, shape (height, width) or (height, width, 3)
        Values as in the file, without transparency; 16-bit grey with transparency has the shape (height, width).

    Raises
    ------
    ImageError
        When the file is missing, truncated, not an image, a raw file, or has more than a hundred million pixels.
    """
    from PIL import Image, UnidentifiedImageError

    from celnav.reading.fits_file import is_fits, read_fits
    from celnav.reading.heif_file import decode, is_heif, open_heif

    refuse_raw(path)
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
                if (layout := _deep_colours(image, path)) is not None:
                    return _read_deep(path, layout)
                if image.format in ("JPEG", "MPO"):  # Pillow's name of a JPEG that announces further pictures
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
    except (OSError, SyntaxError, ValueError, TypeError, EOFError) as error:
        raise ImageError(f"image {path} is damaged or cannot be read: {error}".replace("\n", " ")) from None


@dataclass(frozen=True)
class _Layout:
    """Layout of the samples in a 16-bit colour picture, of which Pillow would keep only 8 bits.

    Attributes
    ----------
    kind : str
        ``PNG`` or ``TIFF``.
    shape : tuple of int
        Shape of the array in the file.
    planes : bool
        Whether colours are stored as planes, one after the other.
    orientation : int
        Tag 274 of TIFF 6.0: which edges of the picture the first row and column of the file are.
    """

    kind: str
    shape: tuple[int, int, int]
    planes: bool = False
    orientation: int = 1


def _deep_colours(image: Image, path: str | Path) -> _Layout | None:
    """Return the layout of 16-bit colours in an open PNG (its header, W3C PNG 11.2.1) or TIFF; None for other pictures."""
    if image.format == "PNG":
        with Path(path).open("rb") as stream:
            header = stream.read(26)
        samples = _PNG_SAMPLES.get(header[25]) if header[24] == 16 else None
        if samples is None:
            return None
        # If one colour stands for transparency, libpng adds a transparency channel.
        samples = 4 if "transparency" in image.info else samples
        return _Layout("PNG", (image.height, image.width, samples))
    if image.format != "TIFF" or image.mode not in ("RGB", "RGBA", "LA"):
        return None
    tags: Any = image.tag_v2  # type: ignore[attr-defined]
    bits = tags.get(_TIFF_BITS, (1,))
    if max(bits) <= 8:
        return None
    if set(bits) != {16}:
        raise ImageError(f"image {path} has colours of {max(bits)} bits; save it as RGB of 8 or 16 bits")
    # Use the stored size: Pillow reports that of the picture after it is turned upright.
    width, height, samples = int(tags[256]), int(tags[257]), int(tags.get(_TIFF_SAMPLES, len(bits)))
    planes = tags.get(_TIFF_PLANES, 1) == 2
    shape = (samples, height, width) if planes else (height, width, samples)
    return _Layout("TIFF", shape, planes, int(tags.get(_TIFF_ORIENTATION, 1)))


def _read_deep(path: str | Path, layout: _Layout) -> Pixels:
    """Decode a 16-bit colour picture into an array of the size that was checked, without its transparency."""
    import imagecodecs

    most = _MOST_OVERHEAD * 2 * math.prod(layout.shape) + _MOST_TAGS
    if (size := Path(path).stat().st_size) > most:
        raise ImageError(f"image {path} has {size / 1e6:.0f} MB, far more than its pixels take: save it anew")
    found = np.empty(layout.shape, dtype=np.uint16)
    data = Path(path).read_bytes()
    try:
        if layout.kind == "PNG":
            found = imagecodecs.png_decode(data, out=found)
        else:
            found = imagecodecs.tiff_decode(data, index=0, out=found)
    except RuntimeError as error:  # raised for errors of libpng and libtiff
        raise ValueError(str(error)) from None
    upright = _upright(np.moveaxis(found, 0, 2) if layout.planes else found, layout.orientation)
    return np.ascontiguousarray(upright[:, :, 0] if upright.shape[2] < 3 else upright[:, :, :3])


def _upright(pixels: Pixels, orientation: int) -> Pixels:
    """Turn a picture upright according to tag 274 of TIFF 6.0."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _refuse_large(path: str | Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise ImageError(f"image {path} has {width} x {height} pixels; the limit is 100 million")


def _refuse_scans(path: str | Path) -> None:
    """Refuse a JPEG with more scans than any program writes, since each costs a pass over all pixels."""
    data, place, scans = Path(path).read_bytes(), 2, 0
    for _ in range(_MOST_SEGMENTS):
        marker = _MARKER.search(data, place)
        if marker is None or data[marker.end() - 1] == _END_OF_IMAGE:
            return
        place = marker.end()
        if data[place - 1] != _START_OF_SCAN:
            # Segments are skipped by their stated lengths: previews in them have scans of their own.
            place += max(2, int.from_bytes(data[place : place + 2], "big"))
            continue
        scans += 1
        if scans > _MOST_SCANS:
            raise ImageError(f"image {path} has more than {_MOST_SCANS} scans: save it anew")
    raise ImageError(f"image {path} has more than {_MOST_SEGMENTS} segments: save it anew")


def read_mask(path: str, shape: tuple[int, ...] | None = None) -> Mask:
    """Read a mask from a picture that is not black where pixels are not to be used.

    Raises
    ------
    ImageError
        When it cannot be read, hides everything, or does not have the image's shape (if that is given).
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
    """Mask the pixels of a floating-point image that have no value (NaN), which is how FITS marks missing data.

    Parameters
    ----------
    image : ndarray, shape (height, width) or (height, width, 3)
        The image.
    mask : ndarray of bool, shape (height, width), optional
        True where pixels are not used.

    Returns
    -------
    image, mask
        The image with the median in the newly masked pixels, and the mask; both unchanged if every pixel has a value.
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
