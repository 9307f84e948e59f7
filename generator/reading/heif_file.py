"""HEIF pictures, as telephones store them, through the optional package pillow-heif (libheif)."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from generator.errors import GeneratorError
from generator.reading.record import LARGEST_SIDE_PX

ORIENTATION_TAG = 0x0112
SHOWN_FROM_STORED = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
"""Rotation with which a picture is displayed, by its orientation (CIPA DC-008, tag 0x0112)."""
STORED_FROM_SHOWN = SHOWN_FROM_STORED | {6: Image.Transpose.ROTATE_90, 8: Image.Transpose.ROTATE_270}
CHANNELS = {"L": "L", "RGB": "RGB"}


def heif_library() -> Any:
    """The package pillow-heif. Raises GeneratorError with the remedy if it is missing."""
    try:
        import pillow_heif
    except ImportError as error:
        raise GeneratorError("HEIF pictures need the package pillow-heif: pip install 'skybench[heif]'") from error
    return pillow_heif


def heif_pixels(data: bytes, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Decode a picture with one or three channels of 8 bits, rotated back to the sensor's orientation.

    A HEIF file states its rotation in its container, and decoders apply it. Its EXIF orientation, which states the same,
    serves to undo this.

    Parameters
    ----------
    data : bytes
    shape : tuple of int, optional
        Height and width as stored; a picture of another size is not unpacked. By default at most LARGEST_SIDE_PX per side.

    Raises
    ------
    GeneratorError
        The picture is damaged or of another size, or pillow-heif is missing.
    """
    library = heif_library()
    try:
        file = library.open_heif(io.BytesIO(data))
        turned = _orientation(file.info.get("exif"))
        width, height = file.size if turned < 5 else file.size[::-1]
        wrong = max(width, height) > LARGEST_SIDE_PX if shape is None else (height, width) != shape
        if wrong:
            raise GeneratorError(f"a HEIF picture of {width} x {height} pixels")
        if file.mode not in CHANNELS:
            raise GeneratorError(f"a HEIF picture of mode {file.mode}, not {' or '.join(CHANNELS)}")
        picture = Image.fromarray(np.asarray(file))
    except (OSError, SyntaxError, ValueError, RuntimeError, EOFError) as error:
        raise GeneratorError(f"damaged HEIF picture ({error})") from error
    if turned in STORED_FROM_SHOWN:
        picture = picture.transpose(STORED_FROM_SHOWN[turned])
    stored = np.array(picture, dtype=np.uint8)
    if shape is not None and stored.shape[:2] != shape:
        raise GeneratorError(f"damaged HEIF picture (of {stored.shape[1]} x {stored.shape[0]} pixels)")
    return stored


def _orientation(tags: bytes | None) -> int:
    """EXIF orientation; 1 if it is missing or damaged."""
    found = Image.Exif()
    try:
        found.load(tags or b"")
        value = found.get(ORIENTATION_TAG, 1)
    except Exception:  # Pillow raises struct.error, KeyError, OverflowError and others for damaged tags
        return 1
    return value if isinstance(value, int) and 1 <= value <= 8 else 1
