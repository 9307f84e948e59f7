"""The ground seen from a place: the nearest surface in each direction, over a curved Earth and through its air.

A point of height h at the angle theta from the observer, seen from the Earth's centre, has the elevation atan((r cos
theta - r0) / (r sin theta)), where r = R + h. The air bends light towards the Earth: a ray near the ground is an arc
whose curvature is k = 0.13 of the Earth's (Gauss 1826; Torge & Mueller 2012, "Geodesy", 4th ed., section 5.1), so that
light is straight over an Earth of radius R / (1 - k). R is the mean radius of curvature at the observer, the root of M N.
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray

from generator.ground.terrain.geotiff import Elevation, ElevationError
from generator.places.wgs84 import curvature_radii_m

Floats = NDArray[np.float64]

REFRACTION_COEFFICIENT = 0.13
"""Curvature of light relative to that of the Earth; less by day near warm ground, more by night near cold ground."""
FARTHEST_M = 200_000.0
MOST_STEPS = 6000
NODE_M = 1000.0
"""Distance between places at which the map's coordinates are computed; chords deviate by at most 0.1 m below 75 deg of
latitude."""
STEPS_AT_ONCE = 64
_WGS84 = 1


@dataclass(frozen=True, eq=False)
class Outlook:
    """The ground around a place.

    Attributes
    ----------
    edge_deg : (columns,) array
        Elevation of the highest ground at each azimuth; -90 if there is none.
    distance_m : (rows, columns) float32 array
        Distance of the nearest ground in each direction, along the ground; infinite if there is none.
    ground_m : float
        Height of the ground at the place.
    """

    edge_deg: Floats
    distance_m: NDArray[np.float32]
    ground_m: float


def elevation_angle_deg(distance_m: Floats, height_m: Floats, eye_m: float, radius_m: float) -> Floats:
    """Apparent elevation of points at distances along the ground, deg; heights and distances broadcast.

    Parameters
    ----------
    distance_m, height_m : arrays
    eye_m : float
        Height of the observer.
    radius_m : float
        Radius of the Earth, without refraction.
    """
    effective = radius_m / (1 - REFRACTION_COEFFICIENT)
    angle = distance_m / effective
    # r cos theta - r0, without the loss of digits in a difference of radii.
    up = height_m - eye_m - 2 * (effective + height_m) * np.sin(angle / 2) ** 2
    return np.degrees(np.arctan2(up, (effective + height_m) * np.sin(angle)))


def outlook(
    elevation: Elevation, place: tuple[float, float], eye_height_m: float, azimuth_deg: Floats, altitude_deg: Floats
) -> Outlook:
    """The ground around a place.

    Parameters
    ----------
    elevation : Elevation
    place : (latitude, longitude)
        Geodetic position, deg.
    eye_height_m : float
        Height above the raster's ground at the place.
    azimuth_deg : (columns,) array
    altitude_deg : (rows,) array
        Altitudes, evenly spaced, from top to bottom.

    Raises
    ------
    ElevationError
        The raster has no height at the place.
    """
    here = elevation.at_place(*place)
    if here is None:
        raise ElevationError(f"the raster has no height at latitude {place[0]:g}, longitude {place[1]:g} deg")
    ground, place = here[0], (place[0], here[1])
    radius = float(np.sqrt(np.prod([float(part) for part in curvature_radii_m(np.array(place[0]))])))
    reach, step = _reach_and_step(elevation, place, radius)
    node = np.arange(0.0, reach + NODE_M, NODE_M)
    columns, rows = elevation.grid.pixel(*_along_azimuths(place, azimuth_deg, node, radius))
    distances = np.arange(step / 2, reach, step)
    edge = np.full(len(azimuth_deg), -90.0)
    nearest = np.full((len(altitude_deg), len(azimuth_deg)), np.inf, np.float32)
    rise = (altitude_deg[0] - altitude_deg[-1]) / (len(altitude_deg) - 1)
    # From far to near, so that the nearest ground in each direction remains.
    for first in range(0, len(distances), STEPS_AT_ONCE)[::-1]:
        away = distances[first : first + STEPS_AT_ONCE]
        cell = np.minimum((away / NODE_M).astype(np.intp), len(node) - 2)
        part = (away / NODE_M - cell)[:, None]
        at = (c[cell] * (1 - part) + c[cell + 1] * part for c in (columns, rows))
        seen = elevation_angle_deg(away[:, None], elevation.at(*at), ground + eye_height_m, radius)
        edge = np.fmax(edge, np.fmax.reduce(seen, axis=0))
        # The uppermost row whose centre this ground hides.
        top = np.ceil((altitude_deg[0] - seen) / rise)
        hit, ray = np.nonzero(top < len(altitude_deg))
        line = np.maximum(top[hit, ray], 0).astype(np.intp)
        np.minimum.at(nearest, (line, ray), away[hit].astype(np.float32))
    # Anything in front of a row is also in front of all rows below it.
    return Outlook(edge, np.minimum.accumulate(nearest, axis=0), ground)


def _reach_and_step(elevation: Elevation, place: tuple[float, float], radius_m: float) -> tuple[float, float]:
    """Distance over which to follow the ground, to the raster's farthest corner, and the step, half a pixel; m."""
    ny, nx = elevation.height_m.shape
    there = _along_azimuths(place, np.array([0.0, 90.0]), np.array([0.0, 100.0]), radius_m)
    column, row = elevation.grid.pixel(*there)
    # Pixels per metre towards north and east.
    slope = np.array([np.diff(column, axis=0)[0], np.diff(row, axis=0)[0]]) / 100.0
    to_metres = np.linalg.inv(slope)
    corners = np.array([[x - column[0, 0], y - row[0, 0]] for x in (0, nx) for y in (0, ny)]).T
    reach = float(np.hypot(*(to_metres @ corners)).max()) * 1.02
    pixel = float(np.hypot(*to_metres).min())
    reach = min(max(reach, pixel), FARTHEST_M)
    return reach, max(pixel / 2, reach / MOST_STEPS)


def _along_azimuths(
    place: tuple[float, float], azimuth_deg: Floats, distance_m: Floats, radius_m: float
) -> tuple[Floats, Floats]:
    """Latitudes and longitudes, deg, at distances along azimuths, (distances, azimuths) arrays."""
    latitude, longitude = np.radians(place[0]), np.radians(place[1])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    north = np.cross(up, east)
    turn = np.radians(azimuth_deg)[:, None]
    level = np.sin(turn) * east + np.cos(turn) * north
    # Points of the horizontal plane above the ground at these distances are in the vertical planes of the azimuths.
    points = (
        erfa.gd2gc(_WGS84, longitude, latitude, 0.0) + radius_m * np.tan(distance_m / radius_m)[:, None, None] * level
    )
    longitudes, latitudes, _ = erfa.gc2gd(_WGS84, points)
    # Continuous around the place.
    longitudes = longitude + (longitudes - longitude + np.pi) % (2 * np.pi) - np.pi
    return np.degrees(latitudes), np.degrees(longitudes)
