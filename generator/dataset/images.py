"""Encoding of images for storage: 16-bit PNG or lossless JPEG XL."""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator
from contextlib import contextmanager

import imagecodecs
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from generator.errors import GeneratorError
from generator.frame.render import png_bytes
from generator.reading.heif_file import heif_pixels
from generator.reading.jpeg_scans import excess
from generator.reading.jxl_header import jxl_shape
from generator.reading.png_header import check_png
from generator.reading.record import LARGEST_SIDE_PX
from generator.sensor.photo import PHOTO_SUFFIXES

JXL_EFFORT = 1
DEPTHS = ("I;16", "I;16B")
"""Pillow's modes for 16 bits and one channel."""
PICTURE_MODES = ("L", "RGB")
PHOTOS = tuple(PHOTO_SUFFIXES.values())
"""Suffixes of photograph files."""
HEIF_MARK = b"ftyp"
"""Mark at the fourth byte of a file of HEIF's family (ISO/IEC 14496-12)."""


def encode(dn: NDArray[np.uint16], codec: str) -> bytes:
    """Encode DN without loss.

    Parameters
    ----------
    dn : (height, width) uint16 array
    codec : str
        ``png`` or ``jxl``.
    """
    if codec == "png":
        return png_bytes(dn)
    return bytes(imagecodecs.jpegxl_encode(dn, effort=JXL_EFFORT, lossless=True))


def decode(data: bytes, codec: str, shape: tuple[int, int] | None = None) -> NDArray[np.uint16]:
    """Decode an image encoded by :func:`encode`.

    Parameters
    ----------
    data : bytes
    codec : str
        ``png`` or ``jxl``.
    shape : tuple of int, optional
        Height and width (px) in its frame record; an image of another size is not unpacked. Without a record the image
        may have up to LARGEST_SIDE_PX per side.

    Raises
    ------
    GeneratorError
        The image is damaged, of another size, or not of 16 bits.
    """
    if codec == "png":
        with _png(data, shape, DEPTHS) as image:
            return np.array(image, dtype=np.uint16)
    if shape is None:
        shape = jxl_shape(data)
        if max(shape) > LARGEST_SIDE_PX:
            raise GeneratorError(f"a JPEG XL of {shape[1]} x {shape[0]} pixels, more than {LARGEST_SIDE_PX} a side")
    try:
        # The decoder compares the header with the array before it unpacks anything.
        return np.asarray(imagecodecs.jpegxl_decode(data, out=np.empty(shape, dtype=np.uint16)), dtype=np.uint16)
    except (imagecodecs.JpegxlError, ValueError, RuntimeError) as error:
        raise GeneratorError(f"not a JPEG XL image of {shape[1]} x {shape[0]} pixels ({error})") from error


def picture(data: bytes, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Decode an 8-bit PNG with one or three channels; `shape` is as for :func:`decode`. Raises GeneratorError."""
    with _png(data, shape, PICTURE_MODES) as image:
        return np.array(image, dtype=np.uint8)


def photo(data: bytes, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Decode a JPEG or HEIF with one or three channels, as the sensor stored it, regardless of its orientation tag.

    `shape` is as for :func:`decode`.

    Raises
    ------
    GeneratorError
        The photograph is damaged, of another size or of too many scans; or it is HEIF and pillow-heif is missing.
    """
    if data[4:8] == HEIF_MARK:
        return heif_pixels(data, shape)
    if (too_many := excess(data)) is not None:
        raise GeneratorError(f"a JPEG of {too_many}, which is not unpacked")
    try:
        with Image.open(io.BytesIO(data), formats=["JPEG"]) as image:
            # Nothing is unpacked before its size is known.
            wrong = max(image.size) > LARGEST_SIDE_PX if shape is None else image.size != (shape[1], shape[0])
            if wrong:
                raise GeneratorError(f"a JPEG of {image.width} x {image.height} pixels")
            if image.mode not in PICTURE_MODES:
                raise GeneratorError(f"a JPEG of mode {image.mode}, not {' or '.join(PICTURE_MODES)}")
            return np.array(image, dtype=np.uint8)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise GeneratorError(f"damaged JPEG ({error})") from error


@contextmanager
def _png(data: bytes, shape: tuple[int, int] | None, modes: Collection[str]) -> Iterator[Image.Image]:
    """Open an image whose header agrees with its frame's record; any error in its pixels is raised as GeneratorError."""
    check_png(data, shape)
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if image.mode not in modes:
                raise GeneratorError(f"a PNG of mode {image.mode}, not {' or '.join(modes)}")
            yield image
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        # Pillow reports a truncated or corrupted stream as any of these.
        raise GeneratorError(f"damaged PNG ({error})") from error
