"""Thin cloud: the optical depth of one layer, which dims everything above it."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.special import ndtr, ndtri

from generator.light.cloud_phase import ICE_ASYMMETRY, WATER_ASYMMETRY
from generator.places.earth import EQUATORIAL_RADIUS_KM

Floats = NDArray[np.float64]

COARSE_CELLS, COARSE_CELL_KM = 1024, 0.125
FINE_CELLS, FINE_CELL_KM = 512, 0.0125
SPLIT_PER_KM = 3.2
"""Wave number that separates the tiles: waves longer than 1 / SPLIT_PER_KM are in the coarse tile of 128 km, shorter ones in
the fine tile of 6.4 km."""

SWEPT_STEP_KM = 0.1
"""Distance that the wind covers between two moments of an exposure at which the cloud is evaluated: ten pixels of a wide
camera at 2 km."""
LEAST_TRANSMISSION = 1e-30
"""Least transmission of cloud: 75 magnitudes."""
MOST_MOMENTS = 6
"""Limits the time of a frame with fast cloud."""
MEAN_STEP = 0.01
"""Step, in standard deviations of the fine field, in which the coarse field is counted for the mean depth."""
COARSE_STEP = 4
"""Step in cells at which the reflectance is evaluated."""
CELL_WIDTH = 0.3
"""Width of the wave band of cells relative to its wave number."""
LEAST_PASSED = 1e-4
"""Least fraction of the power of short waves that a thick layer leaves."""
CELL_SHARE = 0.6
"""Fraction of the field's variance in that band."""


@dataclass(frozen=True)
class Texture:
    """Deviation of a kind of cloud from a power spectrum that is the same in all directions.

    Attributes
    ----------
    stretch : float
        Length of waves along the wind relative to that across.
    wind_azimuth_deg : float
        Azimuth towards which the wind blows.
    cell_km : float
        Distance between cells; 0 for none.
    thickness_km : float
        Thickness of the layer; transmitted light spreads sideways.
    """

    stretch: float = 1.0
    wind_azimuth_deg: float = 0.0
    cell_km: float = 0.0
    thickness_km: float = 0.0

    def passed(self, k: Floats) -> Floats:
        """Fraction of the power of waves (per km) that sideways transport leaves.

        Light that enters a dense layer at a point leaves the other side as a spot whose root mean square radius is close
        to the thickness, whatever the depth (Davis & Marshak 2002, J. Atmos. Sci. 59, 2713), so that shorter waves hardly
        show (Marshak et al. 1995, J. Geophys. Res. 100, 26247). The spot is taken as Gaussian, and as an average over the
        depth.
        """
        return np.maximum(np.exp(-((2 * np.pi * k * self.thickness_km) ** 2) / 2), LEAST_PASSED)

    def power(self, kx: Floats, ky: Floats, slope: float, outer_scale_km: float) -> Floats:
        """Power at wave numbers towards east and north, per km; (n, m) array for (1, m) and (n, 1)."""
        turn = np.radians(self.wind_azimuth_deg)
        along = (kx * np.sin(turn) + ky * np.cos(turn)) * np.sqrt(self.stretch)
        across = (kx * np.cos(turn) - ky * np.sin(turn)) / np.sqrt(self.stretch)
        k = np.hypot(along, across)
        power = (k**2 + outer_scale_km**-2) ** (slope / 2)
        if self.thickness_km > 0:
            return self.passed(np.hypot(kx, ky)) * dataclasses.replace(self, thickness_km=0.0).power(
                kx, ky, slope, outer_scale_km
            )
        if self.cell_km == 0:
            return np.asarray(power)
        peak = 1 / self.cell_km
        cells = np.exp(-0.5 * ((k - peak) / (CELL_WIDTH * peak)) ** 2)
        # Variances integrated over the plane: of a ring for the cells, of the power law for the rest.
        ring = 2 * np.pi * peak * CELL_WIDTH * peak * np.sqrt(2 * np.pi)
        rest = 2 * np.pi / (-slope - 2) * outer_scale_km ** (-slope - 2)
        return np.asarray(power + cells * rest / ring * CELL_SHARE / (1 - CELL_SHARE))


@dataclass(frozen=True, eq=False)
class CloudPattern:
    """Vertical optical depth of a layer, periodic: the sum of two Gaussian fields above a threshold, scaled.

    Attributes
    ----------
    coarse, fine : (n, n) arrays
        Tiles whose rows go north and columns east, COARSE_CELL_KM and FINE_CELL_KM apart.
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
        Height of the layer above the camera.
    pattern : CloudPattern
        Its origin is over the site when `east_km` = `north_km` = 0.
    east_km, north_km : float
        How far the wind has carried the field at mid-exposure.
    swept_km : (east, north)
        How far the wind carries it while the shutter is open.
    point_share : float
        Fraction of the optical depth that removes light from a star's image.
    particle_um : float
        Effective diameter of its particles; 0 means that they diffract as widely as they scatter.
    ice : bool
        Whether it consists of crystals, otherwise of droplets.
    camera_km : float
        Height of the camera above the ground.
    """

    altitude_km: float
    pattern: CloudPattern
    east_km: float
    north_km: float
    swept_km: tuple[float, float] = (0.0, 0.0)
    point_share: float = 1.0
    particle_um: float = 0.0
    ice: bool = False
    camera_km: float = 0.0

    @property
    def asymmetry(self) -> float:
        """Mean cosine of the scattering angle of its particles."""
        return ICE_ASYMMETRY if self.ice else WATER_ASYMMETRY

    @property
    def moments(self) -> tuple[CloudField, ...]:
        """Return the field at times evenly spaced over the exposure, stationary at each; one per SWEPT_STEP_KM of wind."""
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
        """Fraction of points' light that reaches their images, mean over the exposure, (...) array for (..., 3)."""
        return self._passed([still.slant_depth(enu) for still in self.moments])

    def _passed(self, depths: list[Floats]) -> Floats:
        return np.asarray(np.mean([np.exp(-self.point_share * depth) for depth in depths], axis=0))

    def depth_and_transmission(self, enu: Floats) -> tuple[Floats, Floats]:
        """Return :meth:`slant_depth` and :meth:`point_transmission` for the same lines of sight."""
        depths = [still.slant_depth(enu) for still in self.moments]
        # With an odd number of moments, one is the middle of the exposure.
        middle = depths[len(depths) // 2] if len(depths) % 2 else self.slant_depth(enu)
        return middle, self._passed(depths)

    def slant_depth(self, enu: Floats) -> Floats:
        """Optical depth along lines of sight at mid-exposure, (...) array for (..., 3) unit vectors above the horizon."""
        ratio = EQUATORIAL_RADIUS_KM / (EQUATORIAL_RADIUS_KM + self.altitude_km)
        horizontal = np.maximum(np.hypot(enu[..., 0], enu[..., 1]), 1e-12)
        cosine = np.sqrt(1 - (horizontal * ratio) ** 2)
        # Sine of the angle at the Earth's centre between the site and the point on the layer, computed without a
        # difference of angles, so that single precision (as in the emitter) suffices.
        turned = horizontal * (1 - ratio) * (1 + ratio) / (cosine + ratio * enu[..., 2])
        away = EQUATORIAL_RADIUS_KM * np.arcsin(turned) / horizontal
        north, east = enu[..., 1] * away - self.north_km, enu[..., 0] * away - self.east_km
        return self.pattern.depth(north, east) / cosine


@dataclass(frozen=True)
class CloudVeil:
    """Transmission of diffuse light through a cloud, as a function of direction.

    Attributes
    ----------
    clouds : CloudField
    """

    clouds: CloudField

    def at(self, enu: Floats) -> Floats:
        """Transmission, (...) array for (..., 3) unit vectors; mean over the exposure."""
        asymmetry = self.clouds.asymmetry
        passed = [diffuse_transmission(still.slant_depth(enu), asymmetry) for still in self.clouds.moments]
        return np.asarray(np.mean(passed, axis=0))


def level_or_up(enu: Floats) -> Floats:
    """Replace directions (n, 3) below the horizontal by horizontal ones, because cloud is above the camera."""
    return enu * np.array([1.0, 1.0, 0.0]) + np.maximum(enu * np.array([0.0, 0.0, 1.0]), 0)


def behind_cloud(v_mag: Floats, clouds: CloudField | None, enu: Floats) -> Floats:
    """V of n points of light behind cloud, in directions (n, 3)."""
    if clouds is None:
        return v_mag
    passed = clouds.point_transmission(level_or_up(enu))
    return v_mag - 2.5 * np.log10(np.maximum(passed, LEAST_TRANSMISSION))


def gaussian_tile(
    cells: int,
    cell_km: float,
    slope: float,
    outer_scale_km: float,
    band_per_km: tuple[float, float],
    random: np.random.Generator,
    texture: Texture = Texture(),
) -> tuple[NDArray[np.float32], float]:
    """Draw a periodic Gaussian field with waves of one band, and return its expected variance, too.

    Its power is k^slope above 1 / outer scale and flat below, the same function of the wave number for every tile. A
    texture stretches it and adds the waves of cells.
    """
    amplitude, variance = _tile_amplitude(cells, cell_km, slope, outer_scale_km, band_per_km, texture)
    white = fft.rfft2(random.standard_normal((cells, cells)).astype(np.float32))
    return np.asarray(fft.irfft2(white * amplitude, s=(cells, cells)), dtype=np.float32), variance


@functools.lru_cache(maxsize=4)
def _tile_amplitude(
    cells: int, cell_km: float, slope: float, outer_scale_km: float, band_per_km: tuple[float, float], texture: Texture
) -> tuple[NDArray[np.float32], float]:
    """Return factors on the transform of white noise on a tile, (cells, cells / 2 + 1) array, and the expected variance."""
    ky: Floats = np.fft.fftfreq(cells, cell_km).astype(np.float64)[:, None]
    kx: Floats = np.fft.rfftfreq(cells, cell_km).astype(np.float64)[None, :]
    k = np.hypot(kx, ky)
    power = texture.power(kx, ky, slope, outer_scale_km)
    power = power * ((k >= band_per_km[0]) & (k < band_per_km[1])) / cell_km**2
    power[0, 0] = 0
    # Waves of the other half have the same power; those of the first and the last column have no counterpart.
    variance = (2 * power.sum() - power[:, 0].sum() - power[:, -1].sum()) / cells**2
    return np.sqrt(power).astype(np.float32), float(variance)


def cloud_pattern(
    mean_optical_depth: float,
    coverage: float,
    spectral_slope: float,
    outer_scale_km: float,
    random: np.random.Generator,
    texture: Texture = Texture(),
) -> CloudPattern:
    """Draw a layer of cloud.

    The lowest values of a Gaussian field become clear sky so that `coverage` of the area is cloud, and the rest is scaled
    to the mean. A slope of -8/3 in two dimensions corresponds to -5/3 along a line through turbulence, as observed for
    liquid water (Davis et al. 1996, J. Atmos. Sci. 53, 1538). It holds from the outer scale to twice FINE_CELL_KM, which
    is finer than a wide camera's pixel seen from the ground.
    """
    band = (0.0, SPLIT_PER_KM), (SPLIT_PER_KM, 0.5 / FINE_CELL_KM)
    coarse, _ = gaussian_tile(COARSE_CELLS, COARSE_CELL_KM, spectral_slope, outer_scale_km, band[0], random, texture)
    fine, fine_variance = gaussian_tile(
        FINE_CELLS, FINE_CELL_KM, spectral_slope, outer_scale_km, band[1], random, texture
    )
    fine_sigma = float(np.sqrt(fine_variance))
    sigma = float(np.hypot(coarse.std(), fine_sigma))
    lowest = float(coarse.min()) - 3 * fine_sigma
    threshold = float(sigma * ndtri(1 - coverage)) if coverage < 1 else lowest
    mean = _mean_above(coarse, threshold, fine_sigma)
    return CloudPattern(coarse, fine, threshold, mean_optical_depth / max(mean, 1e-12), mean_optical_depth)


def _mean_above(coarse: NDArray[np.float32], threshold: float, sigma: float) -> float:
    """Mean excess above a threshold of a field plus a Gaussian one with a given standard deviation.

    The field is counted in steps of MEAN_STEP sigma; the result is within 1e-5 sigma of the mean over its cells.
    """
    lowest = float(coarse.min())
    above_lowest = coarse - np.float32(lowest)
    above_lowest *= np.float32(1 / (MEAN_STEP * sigma))
    counts = np.bincount(above_lowest.astype(np.int32).ravel())
    above = (lowest - threshold) / sigma + MEAN_STEP * (np.arange(len(counts)) + 0.5)
    density = np.exp(-0.5 * above**2) / np.sqrt(2 * np.pi)
    return sigma * float(counts @ (density + above * ndtr(above))) / coarse.size


def diffuse_transmission(depth: ArrayLike, asymmetry: float = WATER_ASYMMETRY) -> Floats:
    """Fraction of diffuse light that a cloud transmits: 1 / (1 + 3/4 (1 - g) depth); it reflects the rest.

    Eddington's approximation without absorption. Source: Meador & Weaver 1980, J. Atmos. Sci. 37, 630, table 1.
    """
    return 1 / (1 + 0.75 * (1 - asymmetry) * np.asarray(depth, float))


@functools.lru_cache(maxsize=4)
def mean_reflectance(pattern: CloudPattern, asymmetry: float = WATER_ASYMMETRY) -> float:
    """Fraction of diffuse light that a layer reflects, mean over its area."""
    # Sampled where nodes of both tiles coincide.
    coarse = np.arange(0, COARSE_CELLS, COARSE_STEP)
    fine = coarse * round(COARSE_CELL_KM / FINE_CELL_KM) % FINE_CELLS
    field = pattern.coarse[::COARSE_STEP, ::COARSE_STEP] + pattern.fine[np.ix_(fine, fine)]
    depth = pattern.scale * np.maximum(field - np.float32(pattern.threshold), 0)
    return float(np.mean(1 - diffuse_transmission(depth, asymmetry)))
