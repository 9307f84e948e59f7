"""Panoramas of Stellarium's landscapes, by type.

The geometry is that of Stellarium's own programs (its user guide, chapter "Landscapes"; directions as in its test of
opacity): the azimuth of a picture's left edge is 90 deg + ``angle_rotatez`` (spherical, old_style); a fisheye picture has
south at the top and east on the right. Fog layers, labels and the section [location] are ignored, because the scenario
states air and place.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.ground.panorama import MOST_TEXELS, Bytes, Panorama, cropped, row_altitudes
from generator.ground.picture import PictureError, equirectangular, fisheye, read_picture
from generator.ground.stellarium.old_style import old_style
from generator.ground.stellarium.package import INI, Package, PackageError
from generator.ground.stellarium.polygon import ground_colour, polygonal

Floats = NDArray[np.float64]

EAST_DEG = 90.0
SOUTH_DEG = 180.0
LARGEST_FOV_DEG = 360.0


def read_landscape(path: Path, name: str) -> Panorama:
    """Panorama of a landscape package.

    Raises
    ------
    PackageError, PictureError
        The package cannot be used.
    """
    package = Package(path, name)
    with package.archive:
        kind = package.text("type")
        if kind not in TYPES:
            raise PackageError(f"'{name}': {INI}: type = {kind}: expected one of {', '.join(TYPES)}")
        return TYPES[kind](package)


def picture(package: Package, key: str) -> Bytes:
    """The picture that a key names, (height, width, 4) array. Raises PackageError or PictureError."""
    return read_picture(package.file(key), f"{package.name}: {package.text(key)}")


def spherical(package: Package) -> Panorama:
    """An equirectangular picture; below its lower edge there is ground of `bottom_cap_color`."""
    rgba = picture(package, "maptex")
    top, bottom = _edges(package, "maptex")
    glow = None
    if package.has("maptex_illum"):
        glow = _moved(
            premultiplied(picture(package, "maptex_illum")), _edges(package, "maptex_illum"), (top, bottom), rgba
        )
    left = EAST_DEG + package.number("angle_rotatez", 0.0, -1000, 1000)
    return closed(equirectangular(rgba, top, bottom, left, glow), bottom, ground_colour(package, "bottom_cap_color"))


def _edges(package: Package, key: str) -> tuple[float, float]:
    top = package.number(f"{key}_top", 90.0, -90, 90)
    bottom = package.number(f"{key}_bottom", -90.0, -90, 90)
    if bottom >= top:
        raise PackageError(f"'{package.name}': {INI}: {key}_bottom ({bottom:g}) must be below {key}_top ({top:g})")
    return top, bottom


def premultiplied(rgba: Bytes) -> Bytes:
    """Colour of a layer of light, weighted with its alpha."""
    return np.rint(rgba[..., :3] * (rgba[..., 3:] / 255)).astype(np.uint8)


def _moved(glow: Bytes, own: tuple[float, float], wanted: tuple[float, float], like: Bytes) -> Bytes:
    """A layer of light between its own altitudes, on the pixels of a picture between others (the nearest pixels)."""
    height, width = like.shape[:2]
    altitude = row_altitudes(height, *wanted)
    row = np.floor((own[0] - altitude) / (own[0] - own[1]) * len(glow)).astype(np.intp)
    column = np.arange(width) * glow.shape[1] // width
    inside = (row >= 0) & (row < len(glow))
    result = glow[np.clip(row, 0, len(glow) - 1)[:, None], column]
    result[~inside] = 0
    return result


def fisheye_landscape(package: Package) -> Panorama:
    """A fisheye picture; beyond its circle the landscape is opaque."""
    rgba = picture(package, "maptex")
    size = min(rgba.shape[:2])
    # Stellarium stretches a texture to a square; the circle is that of its height.
    if rgba.shape[0] != rgba.shape[1]:
        raise PictureError(f"'{package.name}': maptex has {rgba.shape[1]} x {rgba.shape[0]} pixels; make it square")
    fov = package.number("texturefov", LARGEST_FOV_DEG, 1, LARGEST_FOV_DEG)
    glow = premultiplied(picture(package, "maptex_illum")) if package.has("maptex_illum") else None
    if glow is not None and glow.shape[:2] != (size, size):
        raise PictureError(f"'{package.name}': maptex_illum has another size than maptex; make them the same")
    up = SOUTH_DEG + package.number("angle_rotatez", 0.0, -1000, 1000)
    return closed(fisheye(rgba, fov, up, False, glow), 90 - fov / 2, np.zeros(3, np.uint8))


def closed(panorama: Panorama, bottom_deg: float, colour: Bytes) -> Panorama:
    """The panorama with opaque ground of one colour from an altitude to the nadir."""
    if bottom_deg <= -90:
        return panorama
    ny, nx = panorama.shape
    step = (panorama.top_deg - panorama.bottom_deg) / ny
    # Rows of the picture's own height reach to the nadir, or slightly beyond: the last row is cut at its edge.
    gap = round((panorama.bottom_deg - bottom_deg) / step)
    more = int(np.ceil((bottom_deg + 90) / step - 1e-9))
    more = min(more, MOST_TEXELS // nx - ny - gap)
    rows = gap + more
    alpha = np.zeros((ny + rows, nx), np.uint8)
    alpha[:ny] = panorama.alpha
    alpha[ny + gap :] = 255
    tall = np.empty((ny + rows, nx, 3), np.uint8)
    tall[:ny], tall[ny:] = panorama.colour, colour
    glow = None
    if panorama.glow is not None:
        glow = np.zeros_like(tall)
        glow[:ny] = panorama.glow
    return Panorama(tall, alpha, panorama.top_deg, panorama.bottom_deg - rows * step, glow)


TYPES: dict[str, Callable[[Package], Panorama]] = {
    "spherical": spherical,
    "old_style": lambda package: cropped(old_style(package)),
    "fisheye": fisheye_landscape,
    "polygonal": polygonal,
}
