"""Pictures from other parties: their size is checked before they are decoded, and they are converted to panoramas.

A picture's projection gives the direction of each of its pixels. Equirectangular pictures are panoramas already. A
fisheye's pixels are looked up, bilinearly, at the centres of a panorama's texels, which are as fine as the picture at its
edge.
"""

from __future__ import annotations

import io
import struct
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from generator.ground.panorama import MOST_TEXELS, Bytes, Panorama, column_azimuths, cropped, row_altitudes
from generator.reading.jpeg_scans import excess

Floats = NDArray[np.float64]

FORMATS = ("PNG", "TIFF", "JPEG", "WEBP")
ROWS_AT_ONCE = 128
WHOLE_COLUMN = 0.02
"""A rotation this close to whole columns moves them unchanged; for others, columns are interpolated."""
DAMAGED = (
    OSError,
    SyntaxError,
    ValueError,
    EOFError,
    TypeError,
    LookupError,
    ArithmeticError,
    struct.error,
    Image.DecompressionBombError,
)
"""Exceptions that Pillow raises for files that it cannot read."""


class PictureError(ValueError):
    """The file is not a usable picture; the message says what was found and what is expected."""


def read_picture(data: bytes, name: str) -> Bytes:
    """Decode a picture: (height, width, 4) uint8 array of red, green, blue, alpha; opaque if it has no alpha.

    Raises
    ------
    PictureError
        The picture has another format, too many pixels or scans, or is damaged.
    """
    if (too_many := excess(data)) is not None:
        raise PictureError(f"'{name}' is a JPEG of {too_many}, which are not read: save it anew")
    try:
        with warnings.catch_warnings():
            # Pillow warns of large pictures, which are refused below.
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                width, height = image.size
                if width * height > MOST_TEXELS:
                    raise PictureError(
                        f"'{name}' has {width} x {height} pixels; at most {MOST_TEXELS} are read: make it smaller"
                    )
                if min(width, height) < 2:
                    raise PictureError(f"'{name}' has {width} x {height} pixels, too few for a landscape")
                return np.array(image.convert("RGBA"))
    except PictureError:
        raise
    except DAMAGED as error:
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        wanted = ", ".join(FORMATS)
        raise PictureError(f"'{name}' cannot be read as a picture ({reason}); expected one of {wanted}") from error


def equirectangular(
    rgba: Bytes,
    top_deg: float = 90.0,
    bottom_deg: float = -90.0,
    left_azimuth_deg: float = 0.0,
    glow: Bytes | None = None,
) -> Panorama:
    """Panorama of a picture whose columns go once around, eastwards from `left_azimuth_deg` at its left edge."""
    height, width = rgba.shape[:2]
    columns = left_azimuth_deg / 360 * width
    if abs(columns - round(columns)) < WHOLE_COLUMN:
        turned = np.roll(rgba, round(columns), axis=1)
        shine = None if glow is None else np.roll(glow[:, :, :3], round(columns), axis=1)
        return cropped(Panorama(turned[:, :, :3], turned[:, :, 3], top_deg, bottom_deg, shine))

    def place(altitude: Floats, azimuth: Floats) -> Lookup:
        row = (top_deg - altitude) / (top_deg - bottom_deg) * height - 0.5
        column = ((azimuth - left_azimuth_deg) % 360) / 360 * width - 0.5
        return Lookup(*np.broadcast_arrays(column, row))

    return cropped(resampled(rgba, glow, place, (height, width), top_deg, bottom_deg))


@dataclass(frozen=True)
class Lookup:
    """Places of a panorama's texels in a picture: columns and rows from its upper left pixel's centre; NaN outside it."""

    column: Floats
    row: Floats


Place = Callable[[Floats, Floats], Lookup]
"""Function that returns the places of directions (altitude, azimuth, deg) in a picture."""


def fisheye_lookup(
    width: int, height: int, fov_deg: float, up_azimuth_deg: float, mirrored: bool, altitude: Floats, azimuth: Floats
) -> Lookup:
    """Places of directions in a fisheye picture, whose radius is proportional to the distance from the zenith.

    Parameters
    ----------
    width, height : int
    fov_deg : float
        Field of view across the circle that touches the picture's nearer edges.
    up_azimuth_deg : float
        Azimuth at the centre of the upper edge.
    mirrored : bool
        Whether east is on the right if north is up (as on a map); otherwise it is on the left, as seen when looking up.
    altitude, azimuth : arrays
        deg.
    """
    radius = (90 - altitude) / (fov_deg / 2) * (min(width, height) / 2)
    turn = np.radians(azimuth - up_azimuth_deg) * (1 if mirrored else -1)
    column = width / 2 - 0.5 + radius * np.sin(turn)
    row = height / 2 - 0.5 - radius * np.cos(turn)
    outside = 90 - altitude > fov_deg / 2
    return Lookup(np.where(outside, np.nan, column), np.where(outside, np.nan, row))


def fisheye(
    rgba: Bytes, fov_deg: float, up_azimuth_deg: float = 0.0, mirrored: bool = False, glow: Bytes | None = None
) -> Panorama:
    """Panorama of a fisheye picture; see :func:`fisheye_lookup`."""
    height, width = rgba.shape[:2]
    across = min(width, height)
    bottom = 90 - fov_deg / 2
    columns = int(np.clip(np.pi * across, 64, 8192))
    rows = int(np.clip(across / 2, 32, MOST_TEXELS // columns))

    def place(altitude: Floats, azimuth: Floats) -> Lookup:
        return fisheye_lookup(width, height, fov_deg, up_azimuth_deg, mirrored, altitude, azimuth)

    return cropped(resampled(rgba, glow, place, (rows, columns), 90.0, bottom))


def resampled(
    rgba: Bytes, glow: Bytes | None, place: Place, shape: tuple[int, int], top_deg: float, bottom_deg: float
) -> Panorama:
    """Panorama of a picture by bilinear look-ups; colours are weighted with alpha, so that hidden colours do not leak."""
    colour, alpha = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.uint8)
    shine = None if glow is None else np.zeros((*shape, 3), np.uint8)
    azimuth = column_azimuths(shape[1])
    altitudes = row_altitudes(shape[0], top_deg, bottom_deg)
    for first in range(0, shape[0], ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        found = place(altitudes[rows, None], azimuth[None, :])
        values = bilinear(rgba, found)
        alpha[rows] = np.rint(values[..., 3])
        colour[rows] = np.rint(values[..., :3])
        if glow is not None and shine is not None:
            opaque = np.concatenate([glow[:, :, :3], np.full((*glow.shape[:2], 1), 255, np.uint8)], axis=2)
            shine[rows] = np.rint(bilinear(opaque, found)[..., :3])
    return Panorama(colour, alpha, top_deg, bottom_deg, shine)


def bilinear(rgba: Bytes, found: Lookup) -> NDArray[np.float32]:
    """Colour (weighted with alpha) and alpha at places in a picture, 0 to 255, (..., 4) array; 0 outside it."""
    height, width = rgba.shape[:2]
    inside = np.isfinite(found.column) & np.isfinite(found.row)
    inside &= (found.column > -1) & (found.column < width) & (found.row > -1) & (found.row < height)
    column, row = np.where(inside, found.column, 0.0), np.where(inside, found.row, 0.0)
    left, top = np.floor(column), np.floor(row)
    total = np.zeros((*column.shape, 4), np.float32)
    whole = np.zeros(column.shape, np.float32)
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - right - (column - left)) * np.abs(1 - down - (row - top))
            # Beyond the centres of the outermost pixels, their values are continued.
            y = np.clip(top + down, 0, height - 1).astype(np.intp)
            x = np.clip(left + right, 0, width - 1).astype(np.intp)
            pixel = rgba[y, x].astype(np.float32)
            covered = (weight * inside).astype(np.float32) * pixel[..., 3]
            total[..., :3] += covered[..., None] * pixel[..., :3]
            total[..., 3] += covered
            whole += covered
    total[..., :3] /= np.maximum(whole, 1e-6)[..., None]
    return total
