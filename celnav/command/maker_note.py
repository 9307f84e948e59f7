"""Gravity measured by a telephone's accelerometer, from the maker note of a photograph: Apple's AccelerationVector.

Layout and axes follow ExifTool's documentation (lib/Image/ExifTool/MakerNotes.pm, Apple.pm): a header of 14 bytes, then a
TIFF directory with offsets from the header's start; tag 0x0008 has three signed fractions in units of g. For a telephone at
rest they are the direction of gravity along Core Motion's axes: x to the right of the screen, y to its top, z out of it.
Pictures of the rear camera are stored with the telephone's top to the left, so rows run along -y and columns along -x.
"""

from __future__ import annotations

import math
import struct

_HEADER = b"Apple iOS\x00"
_ORDERS = {b"MM": ">", b"II": "<"}
_START = 14
_ACCELERATION, _SIGNED_FRACTION = 0x0008, 10
_MOST_ENTRIES = 512
# If the telephone is shaken or falling, the vector does not give the vertical.
_AT_REST = (0.9, 1.1)

Vector = tuple[float, float, float]


def acceleration_g(note: object) -> Vector | None:
    """Read the acceleration from a maker note, g; None if it has none or is damaged."""
    if not isinstance(note, bytes) or not note.startswith(_HEADER):
        return None
    order = _ORDERS.get(note[12:_START])
    if order is None:
        return None
    try:
        (count,) = struct.unpack_from(f"{order}H", note, _START)
        for number in range(min(count, _MOST_ENTRIES)):
            tag, form, length, place = struct.unpack_from(f"{order}HHII", note, _START + 2 + 12 * number)
            if (tag, form, length) == (_ACCELERATION, _SIGNED_FRACTION, 3):
                values = struct.unpack_from(f"{order}6i", note, place)
                x, y, z = (above / below for above, below in zip(values[::2], values[1::2], strict=True))
                return x, y, z
    except (struct.error, ZeroDivisionError):
        return None
    return None


def up_in_picture(acceleration: Vector, orientation: int, turned: bool) -> Vector | None:
    """Return the direction of the zenith in the camera frame, a unit vector.

    Parameters
    ----------
    acceleration : tuple of float
        Result of :func:`acceleration_g`.
    orientation : int
        EXIF orientation that the camera wrote.
    turned : bool
        Whether the pixels have been rotated by it, as HEIF decoders do; otherwise they are as stored.

    Returns
    -------
    tuple of float or None
        x to the right, y down, z along the boresight. None if the telephone was not at rest, or a rotated picture is
        mirrored.
    """
    length = math.hypot(*acceleration)
    if not _AT_REST[0] <= length <= _AT_REST[1]:
        return None
    x, y, z = acceleration[1] / length, acceleration[0] / length, acceleration[2] / length
    if not turned:
        return x, y, z
    shown = {1: (x, y, z), 3: (-x, -y, z), 6: (-y, x, z), 8: (y, -x, z)}
    return shown.get(orientation)
