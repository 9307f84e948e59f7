"""Twilight by plain quadrature along straight lines: written apart from the generator's, for comparison with it."""

import numpy as np
from scipy.ndimage import map_coordinates

from generator.light.single_scattering import aerosol_phase, rayleigh_phase
from generator.twilight.air_profiles import air_density

RADIUS_KM, TOP_KM, HAZE_KM, HAZE_ALBEDO = 6371.0, 100.0, 1.5, 0.92
HEIGHTS_KM = np.linspace(0, TOP_KM, 20_001)
LOG_DENSITY = np.log(air_density(HEIGHTS_KM) / np.trapezoid(air_density(HEIGHTS_KM), HEIGHTS_KM))
SUN_STEP_DEG, SUN_FROM_DEG, SUN_TO_DEG = 0.05, 72.0, 103.0


def densities(height_km):
    """Of air and haze, km^-1, each with a vertical column of 1."""
    return np.exp(np.interp(height_km, HEIGHTS_KM, LOG_DENSITY)), np.exp(-height_km / HAZE_KM) / HAZE_KM


def slant_columns(height_km, cosine, steps=500):
    """Columns of air and haze upwards; huge where the ground is in the way."""
    height_km, cosine = np.broadcast_arrays(height_km, np.clip(cosine, -1, 1))
    radius = RADIUS_KM + height_km
    length = -radius * cosine + np.sqrt((radius * cosine) ** 2 + (RADIUS_KM + TOP_KM) ** 2 - radius**2)
    lowest = np.maximum(-radius * cosine, 0)
    first, last = -np.sqrt(lowest), np.sqrt(np.maximum(length - lowest, 0))
    y = first[..., None] + (last - first)[..., None] * np.linspace(0, 1, steps + 1)
    along = lowest[..., None] + np.sign(y) * y**2
    middle, step = (along[..., 1:] + along[..., :-1]) / 2, np.diff(along)
    height = (
        np.sqrt(radius[..., None] ** 2 + middle**2 + 2 * radius[..., None] * middle * cosine[..., None]) - RADIUS_KM
    )
    air, haze = densities(np.maximum(height, 0))
    blocked = (cosine < 0) & (radius * np.sqrt(1 - cosine**2) < RADIUS_KM)
    return tuple(np.where(blocked, 1e9, (part * step).sum(axis=-1)) for part in (air, haze))


class PlainAir:
    """Air and haze of given optical depths, without refraction and ozone."""

    def __init__(self, rayleigh, aerosol):
        self.rayleigh, self.aerosol = rayleigh, aerosol
        angle = np.arange(SUN_FROM_DEG, SUN_TO_DEG, SUN_STEP_DEG)
        rows = [slant_columns(height, np.cos(np.radians(angle))) for height in np.arange(0, TOP_KM + 0.1, 0.5)]
        air, haze = np.moveaxis(np.array(rows), 1, 0)
        self.log_sun = np.maximum(-rayleigh * air - aerosol * haze, -200)

    def sunlight(self, height_km, cosine):
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        place = [height_km / 0.5, (angle - SUN_FROM_DEG) / SUN_STEP_DEG]
        return np.exp(map_coordinates(self.log_sun, place, order=1, mode="nearest"))

    def once(self, place, directions, sun, steps=200):
        """Light scattered once that arrives at a place from (n, 3) directions, per solar irradiance, sr^-1."""
        radius = np.linalg.norm(place)
        rise = directions @ place / radius
        root = (radius * rise) ** 2 - (radius**2 - RADIUS_KM**2)
        lands = (rise < 0) & (root > 0)
        to_top = -radius * rise + np.sqrt((radius * rise) ** 2 + (RADIUS_KM + TOP_KM) ** 2 - radius**2)
        length = np.where(lands, -radius * rise - np.sqrt(np.maximum(root, 0)), to_top)
        edge = length[:, None] * np.linspace(0, 1, steps + 1) ** 1.5
        middle, step = (edge[:, 1:] + edge[:, :-1]) / 2, np.diff(edge)
        points = place + directions[:, None, :] * middle[..., None]
        distance = np.linalg.norm(points, axis=-1)
        height = np.maximum(distance - RADIUS_KM, 0)
        air, haze = densities(height)
        crossed = (self.rayleigh * air + self.aerosol * haze) * step
        passed = np.exp(-np.cumsum(crossed, axis=1) + crossed / 2) * self.sunlight(height, (points @ sun) / distance)
        turn = directions @ sun
        return self.rayleigh * rayleigh_phase(turn) * (air * passed * step).sum(
            axis=1
        ) + HAZE_ALBEDO * self.aerosol * aerosol_phase(turn) * (haze * passed * step).sum(axis=1)

    def twice(self, altitude_deg, sun, points=12, across=24):
        """Light scattered twice seen at an altitude towards the y axis from sea level, per solar irradiance, sr^-1."""
        altitude = np.radians(altitude_deg)
        view = np.array([0.0, np.cos(altitude), np.sin(altitude)])
        node, weight = np.polynomial.legendre.leggauss(points)
        root, by_root = (node + 1) / 2 * np.sqrt(60.0), weight / 2 * np.sqrt(60.0)
        height, rise = root**2, view[2]
        along = -RADIUS_KM * rise + np.sqrt((RADIUS_KM * rise) ** 2 + (RADIUS_KM + height) ** 2 - RADIUS_KM**2)
        per_root = 2 * root * (RADIUS_KM + height) / (along + RADIUS_KM * rise)
        below = [
            whole - rest
            for whole, rest in zip(
                slant_columns(np.zeros(1), rise),
                slant_columns(height, (RADIUS_KM * rise + along) / (RADIUS_KM + height)),
                strict=True,
            )
        ]
        passed = np.exp(-self.rayleigh * below[0] - self.aerosol * below[1])
        panels = np.array([-1, -0.2, -0.06, 0, 0.06, 0.2, 0.5, 1.0])
        x, w = np.polynomial.legendre.leggauss(9)
        half = np.diff(panels)[:, None] / 2
        cosine, by_cosine = ((panels[1:] + panels[:-1])[:, None] / 2 + half * x).ravel(), (half * w).ravel()
        turn = (np.arange(across) + 0.5) / across * 2 * np.pi
        air, haze = densities(height)
        total = 0.0
        for k in range(points):
            place = along[k] * view + np.array([0.0, 0.0, RADIUS_KM])
            up = place / np.linalg.norm(place)
            east = np.array([1.0, 0.0, 0.0])
            north = np.cross(up, east)
            flat = np.sqrt(1 - cosine**2)[:, None, None]
            around = np.cos(turn)[:, None] * east + np.sin(turn)[:, None] * north
            directions = (cosine[:, None, None] * up + flat * around).reshape(-1, 3)
            solid = np.repeat(by_cosine, across) * 2 * np.pi / across
            light = self.once(place, directions, sun) * solid
            turned = directions @ view
            scattered = self.rayleigh * air[k] * rayleigh_phase(turned)
            scattered = scattered + HAZE_ALBEDO * self.aerosol * haze[k] * aerosol_phase(turned)
            total += by_root[k] * per_root[k] * passed[k] * (light @ scattered)
        return total
