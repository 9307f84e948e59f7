"""The size that a PNG states, compared with its frame record before anything is unpacked."""

from __future__ import annotations

import struct

from generator.errors import GeneratorError
from generator.reading.record import LARGEST_SIDE_PX

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_HEADER_BYTES = 33
"""Size of the signature and of the first chunk, which contains the image size."""


def png_shape(data: bytes) -> tuple[int, int]:
    """Height and width that a PNG's header states. Raises GeneratorError; nothing is unpacked."""
    if len(data) < PNG_HEADER_BYTES or data[:8] != PNG_SIGNATURE or data[12:16] != b"IHDR":
        raise GeneratorError("not a PNG image")
    width, height = struct.unpack(">II", data[16:24])
    return height, width


def check_png(data: bytes, shape: tuple[int, int] | None) -> None:
    """Compare a PNG's header with the size that its frame record states. Raises GeneratorError; nothing is unpacked."""
    found = png_shape(data)
    if shape is None:
        if max(found) > LARGEST_SIDE_PX:
            raise GeneratorError(f"a PNG of {found[1]} x {found[0]} pixels, more than {LARGEST_SIDE_PX} a side")
    elif found != shape:
        raise GeneratorError(
            f"a PNG of {found[1]} x {found[0]} pixels, the frame record's camera has {shape[1]} x {shape[0]}"
        )
