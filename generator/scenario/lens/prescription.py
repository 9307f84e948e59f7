"""Centred lenses described by their surfaces, and their ghosts to first order.

A ghost is light that surface j reflects back and surface i, in front of it, reflects forward again. Near the axis its
path is a product of matrices that act on a ray's height and reduced angle (Gerrard & Burch 1975, Introduction to Matrix
Methods in Optics, chapter 2; applied to ghosts: Lee & Eisemann 2013, Computer Graphics Forum 32(4), 1; Hullin et al.
2011, ACM Transactions on Graphics 30(4), 108). On the sensor it is a disk, the image of the pupil; the position of its
centre is proportional to the slope of the light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FLAT = math.inf


@dataclass(frozen=True)
class Surface:
    """A spherical surface.

    Attributes
    ----------
    radius_mm : float
        Radius of curvature, positive if the centre is behind the surface; inf for a plane.
    thickness_mm : float
        Distance along the axis to the next surface.
    index : float
        Refractive index behind it.
    """

    radius_mm: float
    thickness_mm: float
    index: float


@dataclass(frozen=True)
class Prescription:
    """A lens.

    Attributes
    ----------
    title, source : str
    surfaces : tuple of Surface
        Surfaces from the front; the aperture stop is a plane between equal indices. The last thickness is replaced by
        the distance to the focus.
    stop : int
        Index of the stop among them.
    f_number : float
    """

    title: str
    source: str
    surfaces: tuple[Surface, ...]
    stop: int
    f_number: float


@dataclass(frozen=True)
class FirstOrderGhost:
    """A ghost of a distant point.

    Attributes
    ----------
    front, back : int
        The reflecting surfaces; `back` may be the sensor, numbered after the last surface.
    share : float
        Its fraction of the light.
    shift_mm : float
        Distance of its centre from the axis per unit of the light's slope.
    diameter_mm : float
        Diameter of the disk.
    """

    front: int
    back: int
    share: float
    shift_mm: float
    diameter_mm: float


Design = Literal["double-gauss", "fisheye"]
PRESCRIPTIONS: dict[Design, Prescription] = {
    "double-gauss": Prescription(
        "Double Gauss, 100 mm f/1.1 (Angenieux)",
        "P. Angenieux, US patent 2,701,982, as tabulated in public collections of lens designs",
        tuple(
            Surface(*row)
            for row in (
                (164.12, 10.99, 1.673), (559.28, 0.23, 1.0), (100.12, 11.45, 1.67), (213.54, 0.23, 1.0),
                (58.04, 22.95, 1.691), (2551.0, 2.58, 1.673), (32.39, 15.66, 1.0), (FLAT, 15.0, 1.0),
                (-40.42, 2.74, 1.699), (192.98, 27.92, 1.62), (-55.53, 0.23, 1.0), (192.98, 7.98, 1.691),
                (-225.28, 0.23, 1.0), (175.1, 8.48, 1.691), (-203.54, 55.742, 1.0),
            )
        ),
        stop=7,
        f_number=1.1,
    ),
    "fisheye": Prescription(
        "Fisheye, 10.5 mm f/2.8 (Nikkor)",
        "US patent 7,161,746, as tabulated in public collections of lens designs",
        tuple(
            Surface(*row)
            for row in (
                (85.0, 2.04, 1.62041), (16.45, 8.32, 1.0), (61.18, 1.70, 1.81600), (20.15, 10.316, 1.0),
                (-204.0, 3.43, 1.72), (-31.26, 0.25, 1.0), (-27.0, 2.78, 1.7725), (11.48, 4.93, 1.72825),
                (-55.84, 5.865, 1.0), (59.67, 2.57, 1.51742), (-14.2, 1.41, 1.83481), (-76.0, 3.66, 1.0),
                (FLAT, 8.776, 1.0), (-1732.0, 1.49, 1.84666), (29.9, 4.02, 1.497), (-21.55, 0.19, 1.0),
                (44.74, 3.21, 1.6516), (-44.74, 41.1, 1.0),
            )
        ),
        stop=12,
        f_number=2.8,
    ),
}  # fmt: skip
"""Public designs by name."""


def indices(lens: Prescription) -> Floats:
    """Refractive indices in front of each surface and behind the last, (surfaces + 1,) array."""
    return np.array([1.0, *(surface.index for surface in lens.surfaces)])


def refraction(surface: Surface, before: float, after: float) -> Floats:
    """Matrix on (height, index x slope) of a refraction."""
    return np.array([[1.0, 0.0], [-(after - before) / surface.radius_mm, 1.0]])


def reflection(surface: Surface, index: float, backward: bool) -> Floats:
    """Matrix of a reflection in a medium; `backward` is true for light that travels towards the front.

    Slopes are height per distance travelled along the axis.
    """
    sign = -1.0 if backward else 1.0
    return np.array([[1.0, 0.0], [2 * sign * index / surface.radius_mm, 1.0]])


def gap(length_mm: float, index: float) -> Floats:
    """Matrix of the path between surfaces."""
    return np.array([[1.0, length_mm / index], [0.0, 1.0]])


def focused(lens: Prescription) -> tuple[Prescription, float]:
    """Return the lens with its sensor at the focus of distant points, and its focal length, mm."""
    way = np.eye(2)
    n = indices(lens)
    for number, surface in enumerate(lens.surfaces):
        way = refraction(surface, n[number], n[number + 1]) @ way
        if number + 1 < len(lens.surfaces):
            way = gap(surface.thickness_mm, n[number + 1]) @ way
    last = lens.surfaces[-1]
    behind = Surface(last.radius_mm, -way[0, 0] / way[1, 0], last.index)
    placed = Prescription(lens.title, lens.source, (*lens.surfaces[:-1], behind), lens.stop, lens.f_number)
    return placed, -1 / way[1, 0]


def ghost_way(lens: Prescription, front: int, back: int) -> list[tuple[int, Floats]]:
    """Return the path of a ghost: matrices in the order of the light, each with the surface that it follows, or -1."""
    n = indices(lens)
    surfaces = lens.surfaces
    way: list[tuple[int, Floats]] = []

    def forward(first: int, stop: int) -> None:
        for number in range(first, stop):
            way.append((number, refraction(surfaces[number], n[number], n[number + 1])))
            way.append((-1, gap(surfaces[number].thickness_mm, n[number + 1])))

    forward(0, back)
    mirror = surfaces[back] if back < len(surfaces) else Surface(FLAT, 0.0, 1.0)
    way.append((back, reflection(mirror, n[back], backward=False)))
    for number in range(back - 1, front, -1):
        way.append((-1, gap(surfaces[number].thickness_mm, n[number + 1])))
        # Light that travels to the front meets the surface from the other side, so its radius changes sign.
        turned = Surface(-surfaces[number].radius_mm, 0.0, 1.0)
        way.append((number, refraction(turned, n[number + 1], n[number])))
    way.append((-1, gap(surfaces[front].thickness_mm, n[front + 1])))
    way.append((front, reflection(surfaces[front], n[front + 1], backward=True)))
    way.append((-1, gap(surfaces[front].thickness_mm, n[front + 1])))
    forward(front + 1, len(surfaces))
    return way


def first_order_ghosts(
    lens: Prescription, coating_reflectance: float | None, sensor_reflectance: float
) -> tuple[FirstOrderGhost, ...]:
    """All ghosts of a lens, the densest disk first.

    Parameters
    ----------
    lens : Prescription
    coating_reflectance : float or None
        Reflectance of surfaces between glass and air; None means no coating, so that Fresnel's law applies. Cemented
        surfaces have no coating.
    sensor_reflectance : float
        Reflectance of the sensor and its window; if 0, there are only ghosts between surfaces of the lens.
    """
    placed, focal_mm = focused(lens)
    n = indices(placed)
    bare = ((n[1:] - n[:-1]) / (n[1:] + n[:-1])) ** 2
    air = (n[1:] == 1) | (n[:-1] == 1)
    reflectance = bare if coating_reflectance is None else np.where(air & (bare > 0), coating_reflectance, bare)
    mirrors = np.append(reflectance, sensor_reflectance)
    pupil_mm = focal_mm / lens.f_number
    # Rays through the centre of the entrance pupil meet the stop at height 0.
    to_stop = np.eye(2)
    for number, surface in enumerate(placed.surfaces[: placed.stop]):
        to_stop = gap(surface.thickness_mm, n[number + 1]) @ refraction(surface, n[number], n[number + 1]) @ to_stop
    chief = -to_stop[0, 1] / to_stop[0, 0]
    stop_mm = abs(to_stop[0, 0]) * pupil_mm
    found = []
    for back in range(1, len(mirrors)):
        for front in range(back):
            share = float(mirrors[front] * mirrors[back])
            if share == 0:
                continue
            total, widest = np.eye(2), stop_mm
            for number, step in ghost_way(placed, front, back):
                total = step @ total
                if number == placed.stop:
                    widest = max(widest, abs(total[0, 0]) * pupil_mm)
            # The stop cuts off rays beyond its edge at each of the passes.
            kept = stop_mm / widest
            shift = total[0, 1] + total[0, 0] * chief
            found.append(
                FirstOrderGhost(front, back, share * kept**2, float(shift), float(abs(total[0, 0]) * pupil_mm * kept))
            )
    return tuple(sorted(found, key=lambda ghost: -ghost.share / max(ghost.diameter_mm, 1e-6) ** 2))
