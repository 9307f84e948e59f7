"""Stellarium's landscapes of the type old_style: pictures side by side on a cylinder, and one on the ground.

`calibrated` pictures reach from `decor_angle_shift` over `decor_alt_angle` deg of altitude, in equal steps of the
altitude, or of its tangent with `tan_mode`. Without `calibrated`, Stellarium's first formula holds: a cylinder of radius
1 whose wall rises from sin(shift) by sin(height), or by tangents with `tan_mode`. The ground's picture lies on a disk of
radius 1 at a depth of tan(`ground_angle_shift`), or its sine: its right is south and its top is east, rotated by
`ground_angle_rotatez`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.ground.panorama import MOST_TEXELS, Bytes, Panorama, column_azimuths, row_altitudes
from generator.ground.picture import Lookup, bilinear, read_picture
from generator.ground.stellarium.package import INI, Package, PackageError

Floats = NDArray[np.float64]

MOST_SIDES = 64
MOST_REPEATS = 64
MOST_COLUMNS = 8192
ROWS_AT_ONCE = 128
EAST_TURNS = 0.25
"""Azimuth of the first side's left edge, in turns."""


@dataclass(frozen=True, eq=False)
class Side:
    """One side: its picture, its light (or None), and the used part of them: x0, y0, x1, y1 from the lower left."""

    rgba: Bytes
    light: Bytes | None
    part: tuple[float, float, float, float]


def old_style(package: Package) -> Panorama:
    """Panorama of a landscape of the type old_style. Raises PackageError or PictureError."""
    sides = _sides(package)
    repeats = package.count("nb_decor_repeat", 1, MOST_REPEATS)
    panels = len(sides) * repeats
    across = max(abs(side.part[2] - side.part[0]) * side.rgba.shape[1] for side in sides)
    columns = int(np.clip(across * panels, 360, MOST_COLUMNS))
    rows = min(columns // 2, MOST_TEXELS // columns)
    ground = _texture(package, "groundtex") if package.has("groundtex") else None
    first = package.flag("draw_ground_first")
    lit = any(side.light is not None for side in sides)
    colour, alpha = np.zeros((rows, columns, 3), np.uint8), np.zeros((rows, columns), np.uint8)
    glow = np.zeros((rows, columns, 3), np.uint8) if lit else None
    altitudes, azimuth = row_altitudes(rows), column_azimuths(columns)
    for start in range(0, rows, ROWS_AT_ONCE):
        part = slice(start, start + ROWS_AT_ONCE)
        altitude = altitudes[part]
        wall, shine = _wall(package, sides, repeats, altitude, azimuth)
        floor = _floor(package, ground, altitude, azimuth)
        layers = (wall, floor) if first else (floor, wall)
        both = over(*layers)
        # Directions below the wall that neither picture covers are ground without colour.
        both[..., 3] = np.where(altitude[:, None] < _lowest(package), 255, both[..., 3])
        colour[part] = np.rint(both[..., :3])
        alpha[part] = np.rint(both[..., 3])
        if glow is not None:
            glow[part] = np.rint(shine)
    return Panorama(colour, alpha, glow=glow)


def over(upper: NDArray[np.float32], lower: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compose one layer over another; colours are not premultiplied by alpha, 0 to 255, (..., 4) arrays."""
    above = upper[..., 3:] / 255
    below = lower[..., 3:] / 255 * (1 - above)
    whole = above + below
    mixed = (upper[..., :3] * above + lower[..., :3] * below) / np.maximum(whole, 1e-6)
    return np.concatenate([mixed, 255 * whole], axis=-1)


def _texture(package: Package, key: str) -> Bytes:
    return read_picture(package.file(key), f"{package.name}: {package.text(key)}")


def _sides(package: Package) -> list[Side]:
    pictures, lights, pixels = [], [], 0
    for number in range(package.count("nbsidetex", 1, MOST_SIDES)):
        pictures.append(_texture(package, f"tex{number}"))
        light = _texture(package, f"light{number}") if package.has(f"light{number}") else None
        lights.append(None if light is None else np.rint(light[..., :3] * (light[..., 3:] / 255)).astype(np.uint8))
        pixels += pictures[-1][..., 0].size * (1 if light is None else 2)
        if pixels > MOST_TEXELS:
            raise PackageError(
                f"'{package.name}': its sides have more than {MOST_TEXELS} pixels together; make them smaller"
            )
    sides = []
    for number in range(package.count("nbside", len(pictures), MOST_SIDES)):
        key = f"side{number}"
        name, *numbers = package.text(key).split(":")
        if (
            not name.startswith("tex")
            or not name[3:].isdecimal()
            or len(numbers) != 4
            or int(name[3:]) >= len(pictures)
        ):
            raise PackageError(
                f"'{package.name}': {INI}: {key} = {package.text(key)}: expected texN:x0:y0:x1:y1 of a known N"
            )
        x0, y0, x1, y1 = (package.parsed(key, text, 0, 1) for text in numbers)
        if x0 == x1 or y0 == y1:
            raise PackageError(f"'{package.name}': {INI}: {key} = {package.text(key)}: uses no part of the picture")
        texture = int(name[3:])
        sides.append(Side(pictures[texture], lights[texture], (x0, y0, x1, y1)))
    return sides


def _lowest(package: Package) -> float:
    """Altitude of the wall's foot, deg; never above the horizon."""
    shift = package.number("decor_angle_shift", 0.0, -90, 90)
    if package.flag("calibrated") or package.flag("tan_mode"):
        return min(shift, 0.0)
    return min(float(np.degrees(np.arctan(np.sin(np.radians(shift))))), 0.0)


def _height(package: Package, altitude_deg: Floats) -> Floats:
    """Fraction of the wall's height, from its foot, at altitudes."""
    shift = package.number("decor_angle_shift", 0.0, -89.9, 89.9)
    height = package.number("decor_alt_angle", 0.0, 0.01, 180)
    tangent = np.tan(np.radians(altitude_deg))
    if package.flag("calibrated"):
        if shift + height > 90:
            raise PackageError(
                f"'{package.name}': {INI}: decor_angle_shift + decor_alt_angle is {shift + height:g}, beyond the zenith"
            )
        if not package.flag("tan_mode"):
            return (altitude_deg - shift) / height
        low, high = np.tan(np.radians([shift, min(shift + height, 89.9)]))
        return np.asarray((tangent - low) / (high - low))
    law = np.tan if package.flag("tan_mode") else np.sin
    return np.asarray((tangent - law(np.radians(shift))) / law(np.radians(min(height, 89.9))))


def _wall(
    package: Package, sides: list[Side], repeats: int, altitude: Floats, azimuth: Floats
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colour and alpha of the sides in rows of altitudes and columns of azimuths, and their light."""
    up = _height(package, altitude)[:, None]
    turn = azimuth / 360 - EAST_TURNS - package.number("decor_angle_rotatez", 0.0, -1000, 1000) / 360
    place = (turn % 1.0) * len(sides) * repeats
    number = np.floor(place).astype(np.intp) % len(sides)
    along = place - np.floor(place)
    result = np.zeros((len(altitude), len(azimuth), 4), np.float32)
    shine = np.zeros((len(altitude), len(azimuth), 3), np.float32)
    for index, side in enumerate(sides):
        columns = np.flatnonzero(number == index)
        x0, y0, x1, y1 = side.part
        height, width = side.rgba.shape[:2]
        inside = (up >= 0) & (up <= 1)
        column = (x0 + along[columns] * (x1 - x0)) * width - 0.5
        row = (1 - (y0 + up * (y1 - y0))) * height - 0.5
        found = Lookup(*np.broadcast_arrays(column[None, :], np.where(inside, row, np.nan)))
        result[:, columns] = bilinear(side.rgba, found)
        if side.light is not None:
            scale = np.array(side.light.shape[:2]) / (height, width)
            there = Lookup((found.column + 0.5) * scale[1] - 0.5, (found.row + 0.5) * scale[0] - 0.5)
            opaque = np.concatenate([side.light, np.full((*side.light.shape[:2], 1), 255, np.uint8)], axis=2)
            shine[:, columns] = bilinear(opaque, there)[..., :3]
    return result, shine


def _floor(package: Package, ground: Bytes | None, altitude: Floats, azimuth: Floats) -> NDArray[np.float32]:
    """Colour and alpha of the ground's disk in rows of altitudes and columns of azimuths."""
    result = np.zeros((len(altitude), len(azimuth), 4), np.float32)
    shift = np.radians(package.number("ground_angle_shift", 0.0, -89.9, 89.9))
    depth = float(np.tan(shift) if package.flag("calibrated") or package.flag("tan_mode") else np.sin(shift))
    if ground is None or depth >= 0:
        return result
    below = altitude < 0
    radius = depth / np.tan(np.radians(np.where(below, altitude, -90.0)))
    turn = np.radians(azimuth + package.number("ground_angle_rotatez", 0.0, -1000, 1000))
    # South is the disk's x axis, east its y axis; a positive rotation goes from south to east, against the azimuth.
    x, y = -radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)
    height, width = ground.shape[:2]
    inside = below[:, None] & (radius[:, None] <= 1)
    column = np.where(inside, (0.5 + x / 2) * width - 0.5, np.nan)
    row = np.where(inside, (0.5 - y / 2) * height - 0.5, np.nan)
    return bilinear(ground, Lookup(column, row))
