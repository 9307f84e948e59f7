"""Encoding of images for storage: 16-bit PNG or lossless JPEG XL."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from generator.errors import GeneratorError
from generator.frame.render import png_bytes

JXL_EFFORT = 1


def encode(dn: NDArray[np.uint16], codec: str) -> bytes:
    """Encode DN without loss.

    Parameters
    ----------
    dn : (height, width) uint16 array
    codec : str
        ``png`` or ``jxl``.

    Raises
    ------
    GeneratorError
        As :func:`check_codec`.
    """
    if codec == "png":
        return png_bytes(dn)
    return bytes(_imagecodecs().jpegxl_encode(dn, effort=JXL_EFFORT, lossless=True))


def decode(data: bytes, codec: str) -> NDArray[np.uint16]:
    """Decode an image that :func:`encode` made. Raises as :func:`check_codec`, or what the decoder raises."""
    if codec == "png":
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            return np.array(image, dtype=np.uint16)
    return np.asarray(_imagecodecs().jpegxl_decode(data), dtype=np.uint16)


def check_codec(codec: str) -> None:
    """Refuse a codec that cannot be used here.

    Raises
    ------
    GeneratorError
        JPEG XL is asked for, but the package imagecodecs is missing.
    """
    if codec == "jxl":
        _imagecodecs()


def _imagecodecs() -> Any:
    try:
        import imagecodecs
    except ImportError as error:
        raise GeneratorError("codec jxl needs the package imagecodecs: pip install 'skybench[jxl]'") from error
    return imagecodecs
