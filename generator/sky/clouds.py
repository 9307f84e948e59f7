"""Thin cloud: optical depth on one layer, which dims what lies above and shines by light from below and the Moon."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates
from scipy.stats import norm

from generator.light.atmosphere import Atmosphere, optical_depth
from generator.light.bake_grids import DEFAULT_ALBEDO
from generator.light.disk_scattering import disk_irradiance
from generator.light.emission import pattern_weights
from generator.light.ground import Albedo, albedo_at
from generator.light.lamps import City
from generator.light.photometry import GRID_NM
from generator.places.earth import EQUATORIAL_RADIUS_KM
from generator.sky.city_light import upward_spectrum
from generator.sky.component import DIFFUSE_EXTINCTION_FACTOR, SkyTable, above_the_air, side_by_side
from generator.sky.directions import sky_grid
from generator.sky.zodiacal import upsampled

Floats = NDArray[np.float64]

COARSE_CELLS, COARSE_CELL_KM = 1024, 0.125
FINE_CELLS, FINE_CELL_KM = 512, 0.0125
SPLIT_PER_KM = 3.2
"""Waves longer than 1 / SPLIT_PER_KM are in the coarse tile of 128 km, shorter ones in the fine tile of 6.4 km."""
LEAST_MOON_SINE = 0.1
"""Below, the Moon's path through the layer is no longer that through a plane."""
ASYMMETRY = 0.85
"""Of cloud droplets and ice, visible light. Source: Bohren 1987, Am. J. Phys. 55, 524."""


SWEPT_STEP_KM = 0.1
"""Of the wind's way during an exposure, per moment at which the cloud is evaluated: ten pixels of a wide camera at 2 km."""
MOST_MOMENTS = 6
"""Bounds the time of a frame with fast cloud."""
CELL_WIDTH = 0.3
"""Width of the band of waves of cells over its wave number."""
CELL_SHARE = 0.6
"""Part of the field's variance in that band."""


@dataclass(frozen=True)
class Texture:
    """How a kind of cloud differs from the same power in all directions.

    Attributes
    ----------
    stretch : float
        Length of waves along the wind over that across.
    wind_azimuth_deg : float
        Towards which it blows.
    cell_km : float
        Distance of cells; 0: none.
    """

    stretch: float = 1.0
    wind_azimuth_deg: float = 0.0
    cell_km: float = 0.0

    def power(self, kx: Floats, ky: Floats, slope: float, outer_scale_km: float) -> Floats:
        """Power by the wave numbers towards east and north, per km; (n, m) array for (1, m) and (n, 1)."""
        turn = np.radians(self.wind_azimuth_deg)
        along = (kx * np.sin(turn) + ky * np.cos(turn)) * np.sqrt(self.stretch)
        across = (kx * np.cos(turn) - ky * np.sin(turn)) / np.sqrt(self.stretch)
        k = np.hypot(along, across)
        power = (k**2 + outer_scale_km**-2) ** (slope / 2)
        if self.cell_km == 0:
            return np.asarray(power)
        peak = 1 / self.cell_km
        cells = np.exp(-0.5 * ((k - peak) / (CELL_WIDTH * peak)) ** 2)
        # Variances over the plane: of the cells a ring's, of the rest that of the power law.
        ring = 2 * np.pi * peak * CELL_WIDTH * peak * np.sqrt(2 * np.pi)
        rest = 2 * np.pi / (-slope - 2) * outer_scale_km ** (-slope - 2)
        return np.asarray(power + cells * rest / ring * CELL_SHARE / (1 - CELL_SHARE))


@dataclass(frozen=True, eq=False)
class CloudPattern:
    """Vertical optical depth of a layer, periodic: the sum of two Gaussian fields above a threshold, scaled.

    Attributes
    ----------
    coarse, fine : (n, n) arrays
        Rows go north, columns east, COARSE_CELL_KM and FINE_CELL_KM apart.
    threshold, scale : float
        Depth is scale x (coarse + fine - threshold), or zero.
    mean_depth : float
        Mean optical depth, clear parts included.
    """

    coarse: NDArray[np.float32]
    fine: NDArray[np.float32]
    threshold: float
    scale: float
    mean_depth: float

    def depth(self, north_km: Floats, east_km: Floats) -> Floats:
        """Vertical optical depth at places on the layer: bilinear in both tiles."""
        place = np.stack([north_km, east_km])
        coarse = map_coordinates(self.coarse, place / COARSE_CELL_KM, order=1, mode="grid-wrap")
        fine = map_coordinates(self.fine, place / FINE_CELL_KM, order=1, mode="grid-wrap")
        return self.scale * np.maximum(coarse + fine - self.threshold, 0)


@dataclass(frozen=True)
class CloudField:
    """Cloud over the site during one frame.

    Attributes
    ----------
    altitude_km : float
    pattern : CloudPattern
        Its origin is over the site when `east_km` = `north_km` = 0.
    east_km, north_km : float
        How far the wind has carried the field at mid-exposure.
    swept_km : (east, north)
        How far the wind carries it while the shutter is open.
    point_share : float
        Part of the optical depth that takes light out of a star's image.
    """

    altitude_km: float
    pattern: CloudPattern
    east_km: float
    north_km: float
    swept_km: tuple[float, float] = (0.0, 0.0)
    point_share: float = 1.0

    @property
    def moments(self) -> tuple[CloudField, ...]:
        """The field at times evenly spaced over the exposure, each at rest; once for every SWEPT_STEP_KM of wind."""
        east, north = self.swept_km
        count = int(np.clip(np.ceil(np.hypot(east, north) / SWEPT_STEP_KM), 1, MOST_MOMENTS))
        after = (np.arange(count) + 0.5) / count - 0.5
        return tuple(
            dataclasses.replace(
                self, east_km=self.east_km + east * part, north_km=self.north_km + north * part, swept_km=(0.0, 0.0)
            )
            for part in after.tolist()
        )

    def point_transmission(self, enu: Floats) -> Floats:
        """Part of the light of points that arrives in their images, mean over the exposure, (...) array for (..., 3)."""
        passed = [np.exp(-self.point_share * still.slant_depth(enu)) for still in self.moments]
        return np.asarray(np.mean(passed, axis=0))

    def slant_depth(self, enu: Floats) -> Floats:
        """Optical depth along lines of sight at mid-exposure, (...) array for (..., 3) unit vectors above the horizon."""
        ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + self.altitude_km)
        horizontal = np.maximum(np.hypot(enu[..., 0], enu[..., 1]), 1e-12)
        cosine = np.sqrt(1 - (horizontal * ratio) ** 2)
        # Sine of the angle at the Earth's centre between the site and the point on the layer, without a difference of
        # angles, so that single precision (the emitter's) does too.
        turned = horizontal * (1 - ratio) * (1 + ratio) / (cosine + ratio * enu[..., 2])
        away = EQUATORIAL_RADIUS_KM * np.arcsin(turned) / horizontal
        north, east = enu[..., 1] * away - self.north_km, enu[..., 0] * away - self.east_km
        return self.pattern.depth(north, east) / cosine


@dataclass(frozen=True)
class CloudVeil:
    """Transmission of a cloud by direction: of diffuse light, or diffusely of the Moon's.

    Attributes
    ----------
    clouds : CloudField
    moon_sine : float
        Sine of the Moon's altitude where its light is spread; 0: light from above is passed on.
    """

    clouds: CloudField
    moon_sine: float = 0.0

    def at(self, enu: Floats) -> Floats:
        """Transmission of diffuse light, or diffusely transmitted part of the Moon's, (...) array; mean over the exposure."""
        return np.asarray(np.mean([self._at(still.slant_depth(enu)) for still in self.clouds.moments], axis=0))

    def _at(self, depth: Floats) -> Floats:
        """The same for optical depths along the lines of sight."""
        if self.moon_sine == 0:
            return diffuse_transmission(depth)
        path = depth / max(self.moon_sine, LEAST_MOON_SINE)
        return np.maximum(diffuse_transmission(path) - np.exp(-self.clouds.point_share * path), 0)


def gaussian_tile(
    cells: int,
    cell_km: float,
    slope: float,
    outer_scale_km: float,
    band_per_km: tuple[float, float],
    random: np.random.Generator,
    texture: Texture = Texture(),
) -> tuple[NDArray[np.float32], float]:
    """A periodic Gaussian field of the waves of a band, and its expected variance.

    Its power is k^slope above 1 / outer scale and flat below, the same function of the wave number for every tile. A texture
    stretches it and adds the waves of cells.
    """
    white = np.fft.rfft2(random.standard_normal((cells, cells)))
    waves: Floats = np.fft.fftfreq(cells, cell_km).astype(np.float64)
    ky, kx = waves[:, None], waves[None, :]
    k = np.hypot(kx, ky)
    power = texture.power(kx, ky, slope, outer_scale_km)
    power = power * ((k >= band_per_km[0]) & (k < band_per_km[1])) / cell_km**2
    power[0, 0] = 0
    field = np.fft.irfft2(white * np.sqrt(power[:, : cells // 2 + 1]), s=(cells, cells))
    return field.astype(np.float32), float(power.mean())


def cloud_pattern(
    mean_optical_depth: float,
    coverage: float,
    spectral_slope: float,
    outer_scale_km: float,
    random: np.random.Generator,
    texture: Texture = Texture(),
) -> CloudPattern:
    """Draw a layer of cloud.

    The lowest values of a Gaussian field are cut to clear sky so that `coverage` of the area is cloud, and the rest is
    scaled to the mean. A slope of -8/3 in two dimensions is the -5/3 of a cut through turbulence, which liquid water shows
    (Davis et al. 1996, J. Atmos. Sci. 53, 1538). It holds from the outer scale to twice FINE_CELL_KM, which from the ground
    is finer than a wide camera's pixel.
    """
    band = (0.0, SPLIT_PER_KM), (SPLIT_PER_KM, 0.5 / FINE_CELL_KM)
    coarse, _ = gaussian_tile(COARSE_CELLS, COARSE_CELL_KM, spectral_slope, outer_scale_km, band[0], random, texture)
    fine, fine_variance = gaussian_tile(
        FINE_CELLS, FINE_CELL_KM, spectral_slope, outer_scale_km, band[1], random, texture
    )
    fine_sigma = float(np.sqrt(fine_variance))
    sigma = float(np.hypot(coarse.std(), fine_sigma))
    lowest = float(coarse.min()) - 3 * fine_sigma
    threshold = float(sigma * norm.ppf(1 - coverage)) if coverage < 1 else lowest
    # Mean over the fine field, which is Gaussian, of what stands above the threshold.
    above = (coarse.astype(float) - threshold) / fine_sigma
    mean = float(np.mean(fine_sigma * (norm.pdf(above) + above * norm.cdf(above))))
    return CloudPattern(coarse, fine, threshold, mean_optical_depth / max(mean, 1e-12), mean_optical_depth)


def diffuse_transmission(depth: ArrayLike) -> Floats:
    """Part of diffuse light that a cloud of optical depth passes on: 1 / (1 + 3/4 (1 - g) depth); the rest it reflects.

    Two-stream approximation without absorption. Source: Bohren 1987, Am. J. Phys. 55, 524, eq. 20.
    """
    return 1 / (1 + 0.75 * (1 - ASYMMETRY) * np.asarray(depth, float))


@functools.lru_cache(maxsize=4)
def mean_reflectance(pattern: CloudPattern) -> float:
    """Part of diffuse light that a layer reflects, mean over its area."""
    cells = np.arange(0, COARSE_CELLS, 4) * COARSE_CELL_KM
    return float(np.mean(1 - diffuse_transmission(pattern.depth(*np.meshgrid(cells, cells, indexing="ij")))))


@functools.lru_cache(maxsize=64)
def light_from_city(
    distance_km: float, azimuth_deg: float, radius_km: float, horizon_share: float | None, altitude_km: float
) -> Floats:
    """Upward irradiance of a :class:`City` at the layer over each direction of a coarse grid, (rows, columns) array.

    Per unit V-band photon output, m^-2.
    """
    grid = sky_grid()
    rows, columns = coarse_axes()
    enu = grid.enu[rows][:, columns]
    ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + altitude_km)
    horizontal = np.hypot(enu[..., 0], enu[..., 1])
    distance = EQUATORIAL_RADIUS_KM * (
        np.arctan2(horizontal, enu[..., 2]) - np.arcsin(np.clip(horizontal * ratio, 0, 1))
    )
    place = enu[..., :2] * (distance / np.maximum(horizontal, 1e-12))[..., None]
    turn = np.radians(azimuth_deg)
    middle = distance_km * np.array([np.sin(turn), np.cos(turn)])
    light = pattern_weights(horizon_share) @ disk_irradiance((place - middle).reshape(-1, 2), altitude_km, radius_km)
    return 1e-6 * light.reshape(enu.shape[:2])


def coarse_axes() -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Every sixth row and column of the grid, the zenith included."""
    ny, nx = sky_grid().shape
    return np.unique(np.append(np.arange(0, ny, 6), ny - 1)), np.arange(0, nx, 6)


def cloud_light(
    clouds: CloudField,
    cities: tuple[City, ...],
    ground_spectrum: Floats,
    moon_irradiance: Floats,
    moon_sine: float,
    atmosphere: Atmosphere | None,
    ground_albedo: Albedo = DEFAULT_ALBEDO,
) -> SkyTable:
    """Light that cloud adds to the sky: reflected light from the ground, and diffusely transmitted moonlight.

    Parameters
    ----------
    clouds : CloudField
    cities : tuple of City
        With their final output.
    ground_spectrum : (n,) array
        Photon irradiance that the ground sends up by reflecting the natural sky and the Moon, s^-1 m^-2 nm^-1.
    moon_irradiance : (n,) array
        Above the air; zero when the Moon is down.
    moon_sine : float
        Sine of its altitude.
    atmosphere : Atmosphere or None
        All of it is taken to lie below the cloud.
    ground_albedo : float or points
        City light goes to and fro between cloud and ground: as between two endless layers.

    Returns
    -------
    SkyTable
        Cloud is a Lambert reflector and transmitter: brighter over a city, and without corona around the Moon.
    """
    even = np.full((sky_grid().shape[0], 1), 1 / np.pi)
    rows, columns = coarse_axes()
    zenith_loss = np.ones_like(GRID_NM)
    if atmosphere is not None:
        zenith_loss = np.exp(-DIFFUSE_EXTINCTION_FACTOR * optical_depth(GRID_NM, atmosphere))
    again = 1 / (1 - albedo_at(ground_albedo, GRID_NM) * mean_reflectance(clouds.pattern))
    from_below = [above_the_air(even, ground_spectrum * zenith_loss, atmosphere)]
    for city in cities:
        shape = light_from_city(
            city.distance_km, city.azimuth_deg, city.radius_km, city.horizon_share, clouds.altitude_km
        )
        fine = upsampled(shape, rows, columns, sky_grid().shape) / np.pi
        output = upward_spectrum(city, ground_albedo) * again
        from_below.append(above_the_air(fine, output * zenith_loss, atmosphere))
    below = side_by_side(from_below)
    # What is not passed on is reflected: 1 less the transmission.
    veiled = [(CloudVeil(clouds), below.scaled(-1.0))]
    if moon_sine > 0:
        moon = above_the_air(even, moon_sine * moon_irradiance, atmosphere)
        veiled.append((CloudVeil(clouds, moon_sine), moon))
    return dataclasses.replace(below, veiled=tuple(veiled))
