"""Reading of HEIF pictures, as stored by telephones, with the optional package pillow-heif (libheif).

The container states how to rotate the picture, and the decoder does so; unlike with JPEG, pixels are therefore upright.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.errors import ImageError

MAX_BYTES = 200_000_000
_FAMILY = b"ftyp"
_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1"}
_CHANNELS = {"L": 1, "LA": 1, "I;16": 1, "RGB": 3, "RGBA": 3, "RGB;16": 3, "RGBA;16": 3}
"""Number of channels to use, by pillow-heif mode."""


@dataclass(frozen=True)
class HeifFile:
    """A picture whose pixels are not decoded yet.

    Attributes
    ----------
    width, height : int
        Size after decoding, pixels.
    tags : bytes
        EXIF data; empty if there is none.
    file : object
        File object of pillow-heif.
    """

    width: int
    height: int
    tags: bytes
    file: Any


def is_heif(path: str | Path) -> bool:
    """Return whether a file starts like HEIF (ISO/IEC 23008-12); False if it cannot be read."""
    try:
        with Path(path).open("rb") as stream:
            start = stream.read(12)
    except OSError:
        return False
    return start[4:8] == _FAMILY and start[8:12] in _BRANDS


def open_heif(path: str | Path) -> HeifFile:
    """Open a picture without decoding it.

    Raises
    ------
    ImageError
        When the file is damaged or larger than 200 MB, or pillow-heif is missing.
    """
    try:
        import pillow_heif
    except ImportError:
        raise ImageError(
            f"image {path} is HEIF, which needs the package pillow-heif: pip install 'skybench[heif]', or save it as PNG"
        ) from None
    size = Path(path).stat().st_size
    if size > MAX_BYTES:
        raise ImageError(
            f"image {path} has {size / 1e6:.0f} MB; the limit of a HEIF picture is {MAX_BYTES // 1_000_000}"
        )
    try:
        file = pillow_heif.open_heif(path, convert_hdr_to_8bit=False)
        (width, height), tags = file.size, file.info.get("exif") or b""
    except (OSError, SyntaxError, ValueError, RuntimeError, EOFError) as error:
        raise ImageError(f"image {path} is damaged or cannot be read: {error}".replace("\n", " ")) from None
    return HeifFile(width, height, tags, file)


def decode(found: HeifFile, path: str | Path) -> NDArray[np.generic]:
    """Decode pixels of 8 or 16 bits, (height, width) or (height, width, 3), without transparency; may raise ImageError."""
    channels = _CHANNELS.get(found.file.mode)
    if channels is None:
        raise ImageError(f"image {path} has the pixel format {found.file.mode}; save it as grey or RGB PNG")
    try:
        pixels: NDArray[np.generic] = np.array(found.file)
    except (OSError, SyntaxError, ValueError, RuntimeError, EOFError) as error:
        raise ImageError(f"image {path} is damaged or cannot be read: {error}".replace("\n", " ")) from None
    if pixels.shape[:2] != (found.height, found.width):
        raise ImageError(f"image {path} is damaged: it is not of the size that it states")
    if pixels.ndim == 3:
        pixels = pixels[..., 0] if channels == 1 else pixels[..., :channels]
    return np.ascontiguousarray(pixels)
