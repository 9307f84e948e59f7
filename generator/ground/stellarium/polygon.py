"""Horizon polygons of Stellarium: lists of azimuths and altitudes, filled below."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from generator.ground.lighting import unit_vectors
from generator.ground.panorama import Bytes, Panorama, cropped
from generator.ground.stellarium.package import INI, LARGEST_LIST_BYTES, Package, PackageError

Floats = NDArray[np.float64]

COLUMNS = 7200
"""Columns of the panorama: one per 0.05 deg."""
FINE = 2
"""Samples per texel and axis of the polygon's edge."""
MOST_POINTS = 20_000
STEP_DEG = 0.25
"""Length of the chords with which a great circle between two points is drawn."""
MODES = {
    "azdeg_altdeg": (1.0, False), "azdeg_zddeg": (1.0, True),
    "azrad_altrad": (180 / math.pi, False), "azrad_zdrad": (180 / math.pi, True),
    "azgrad_altgrad": (0.9, False), "azgrad_zdgrad": (0.9, True),
}  # fmt: skip
"""Degrees per unit, and whether the second column is the distance from the zenith."""
BLACK = (0.0, 0.0, 0.0)


def polygonal(package: Package) -> Panorama:
    """Panorama of a landscape of the type polygonal: everything below the line has one colour."""
    azimuth, altitude = _around(package, *horizon_points(package))
    rows, columns = COLUMNS // 2 * FINE, COLUMNS * FINE
    canvas = Image.new("L", (columns, rows), 0)
    draw = ImageDraw.Draw(canvas)
    v = (90 - altitude) / 180 * rows - 0.5
    for turn in (-360, 0, 360):
        u = (azimuth + turn) / 360 * columns - 0.5
        line = np.stack([u, v], axis=1)
        floor = np.array([[u[-1], 2.0 * rows], [u[0], 2.0 * rows]])
        draw.polygon([tuple(point) for point in np.concatenate([line, floor]).tolist()], fill=255)
    fine = np.asarray(canvas, dtype=np.float32).reshape(rows // FINE, FINE, columns // FINE, FINE)
    alpha = np.rint(fine.mean(axis=(1, 3))).astype(np.uint8)
    colour = np.empty((*alpha.shape, 3), np.uint8)
    colour[:] = ground_colour(package, "ground_color")
    return cropped(Panorama(colour, alpha))


def ground_colour(package: Package, key: str) -> Bytes:
    """A key's colour, by default black, encoded in sRGB, (3,) array; Stellarium uses it as a screen value."""
    colour = package.colour(key, BLACK)
    assert colour is not None
    return np.rint(255 * np.array(colour)).astype(np.uint8)


def horizon_points(package: Package) -> tuple[Floats, Floats]:
    """Azimuths and altitudes of the points of a horizon list, deg. Raises PackageError."""
    key = "polygonal_horizon_list"
    text = package.file(key, LARGEST_LIST_BYTES).decode("utf-8-sig", errors="replace")
    mode = package.text(f"{key}_mode", "azDeg_altDeg")
    if mode.lower() not in MODES:
        raise PackageError(f"'{package.name}': {INI}: {key}_mode = {mode}: expected one of {', '.join(MODES)}")
    unit, from_zenith = MODES[mode.lower()]
    points = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        fields = line.split()
        where = f"{key}, line {number}"
        if len(fields) < 2:
            raise PackageError(f"'{package.name}': {where}: found one number, expected azimuth and altitude")
        points.append([unit * package.parsed(where, field, -1000, 1000) for field in fields[:2]])
        if len(points) > MOST_POINTS:
            raise PackageError(f"'{package.name}': {key} has more than {MOST_POINTS} points; leave some out")
    if len(points) < 3:
        raise PackageError(f"'{package.name}': {key} has {len(points)} points, expected at least 3")
    azimuth, altitude = np.array(points).T
    altitude = 90 - altitude if from_zenith else altitude
    if (np.abs(altitude) >= 90).any():
        raise PackageError(f"'{package.name}': {key} reaches the zenith or the nadir; altitudes run from -90 to 90 deg")
    return azimuth + package.number("polygonal_angle_rotatez", 0.0, -1000, 1000), altitude


def _around(package: Package, azimuth: Floats, altitude: Floats) -> tuple[Floats, Floats]:
    """The closed line once around, eastwards, along great circles in short chords; azimuths continue beyond 360."""
    corners = unit_vectors(altitude, azimuth)
    corners = np.concatenate([corners, corners[:1]])
    angle = np.arccos(np.clip((corners[1:] * corners[:-1]).sum(axis=1), -1, 1))
    count = np.maximum(np.ceil(np.degrees(angle) / STEP_DEG), 1).astype(np.intp)
    piece = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)) / count[piece]
    # Points along the chord have the directions of those along the arc; their spacing does not matter.
    points = corners[piece] * (1 - share)[:, None] + corners[piece + 1] * share[:, None]
    points = np.concatenate([points, corners[:1]])
    turned = np.unwrap(np.arctan2(points[:, 0], points[:, 1]))
    whole = turned[-1] - turned[0]
    if abs(abs(whole) - 2 * np.pi) > 1e-6:
        raise PackageError(
            f"'{package.name}': polygonal_horizon_list does not go once around the horizon; list it in order"
        )
    level = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    return (np.degrees(turned), level) if whole > 0 else (np.degrees(turned)[::-1], level[::-1])
