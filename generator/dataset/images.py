"""Encoding of images for storage: 16-bit PNG or lossless JPEG XL."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from generator.dataset_writer import png_bytes
from generator.errors import GeneratorError

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
        JPEG XL is asked for, but the package imagecodecs is missing.
    """
    if codec == "png":
        return png_bytes(dn)
    try:
        import imagecodecs
    except ImportError as error:
        raise GeneratorError("codec jxl needs the package imagecodecs: pip install imagecodecs") from error
    return bytes(imagecodecs.jpegxl_encode(dn, effort=JXL_EFFORT, lossless=True))


def decode(data: bytes, codec: str) -> NDArray[np.uint16]:
    """Decode an image that :func:`encode` made."""
    if codec == "png":
        with Image.open(io.BytesIO(data)) as image:
            return np.array(image, dtype=np.uint16)
    import imagecodecs

    return np.asarray(imagecodecs.jpegxl_decode(data), dtype=np.uint16)
