"""The diffuse Milky Way: Mellinger's panorama (stars removed), calibrated to S10(V)."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from generator import mitsuba_runtime
from generator.device_arrays import aligned
from generator.errors import DataFileError
from generator.identity.kept import kept
from generator.light.atmosphere import Atmosphere
from generator.light.photometry import ARCSEC2_PER_SR
from generator.light.stellar_spectra import star_spectra
from generator.sky.component import SkyTable, above_the_air
from generator.sky.directions import sky_grid

Floats = NDArray[np.float64]

PANORAMA_PATH = Path(__file__).parents[1] / "data" / "milky_way" / "milkyway.png"
S10_MAG_ARCSEC2 = 27.7815
"""Surface brightness of one star of V 10 per square degree, V mag/arcsec^2."""

# Conversion of the panorama's luminance (linear sRGB) to S10(V): medians of an all-sky star map in bins of luminance;
# below 0.002, where the panorama fades to black, its median at galactic latitude 30 (44 S10). Stars brighter than about V
# 11 are in neither (docs/physics.md).
_LUMINANCE = [0.0, 0.0007, 0.0015, 0.0035, 0.0075, 0.015, 0.03, 0.06, 0.115, 0.22, 1.0]
_S10_V = [20.0, 42.0, 52.0, 73.0, 106.0, 137.0, 173.0, 220.0, 278.0, 378.0, 800.0]
_LATITUDE_DEG = [25.0, 30.0, 45.0, 60.0, 75.0, 90.0]
_LEAST_S10_V = [20.0, 30.0, 29.0, 23.0, 20.0, 20.0]
"""S10(V) where the panorama is black: the same star map's medians by distance from the galactic equator, mean of both sides.
At 30 deg, where it is black only on the fainter longitudes, the tenth percentile is used: 0.65 of the median, as at 0 and
5."""
GALACTIC_POLE: Floats = np.array([-0.8676661490, -0.1980763734, 0.4559837762])
"""ICRS unit vector of the north galactic pole. Source: ESA 1997, SP-1200, volume 1, eq. 1.5.11."""
GALACTIC_CENTRE: Floats = np.array([-0.0548755604, -0.8734370902, -0.4838350155])
"""ICRS unit vector of galactic longitude and latitude 0. Source: ESA 1997, SP-1200, volume 1, eq. 1.5.11."""
BV_MAG, VI_MAG = 0.75, 1.02
"""Colours of integrated starlight away from the galactic centre. Source: B-V of Mattila 1980, A&AS 39, 53 (Pioneer 10 and
galactic models: 0.7 to 0.8); V-I of the sum of the catalogue's stars from V 7 to 8.5 at galactic latitudes beyond 50 deg,
whose B-V is 0.73. A single star of that B-V has 0.84: the red giants of a mixture shine in the infrared."""
CENTRE_BV_MAG, CENTRE_VI_MAG = 1.10, 1.40
"""Colours towards the galactic centre. Source: Elsasser & Haug 1960, Z. Astrophys. 50, 121: colour indices along the galactic
equator from 0.4 to 1.1 mag, redder towards the centre, 1.15 where it is brightest; V-I is that of the mixture above, reddened
to this B-V (E(V-I) = 1.25 E(B-V), Cardelli et al. 1989). As an assumption, the fraction of this light falls with the sixth
power of the cosine of the angle to the centre, to a half at 27 deg."""

FAINT_LIMIT_V_MAG = 11.0
"""Stars brighter than about this are left out of the calibration's medians over a degree."""
DETAIL, DETAIL_DEG = 1.5, 3.0
"""Factor on the contrast of the map within this standard deviation, used together with individually drawn stars to V 11.5,
which replace light that follows the map. It brings the cloud in Sagittarius to 748 S10 (750: Elsasser & Haug 1960; 656
without). Structure of 0.7 to 4 deg within 10 deg of the equator in photographs of an all-sky camera is 1.4 to 1.75 times the
map's from Cygnus to the Eagle, 0.9 to 1.25 times in Auriga and Perseus (docs/realism.md)."""
LEAST_OF_MEAN = 0.3
"""Least light of a place relative to its surroundings after the contrast is raised."""
CATALOGUE_COUNTS = ((8.5, 77_673), (9.0, 126_000), (10.0, 360_000), (10.5, 565_000), (11.0, 880_000))
"""Stars over the whole sky brighter than V. Sources: Tycho-2 (Hog et al. 2000) as V; log N grows by 0.43 per magnitude."""


@functools.cache
def panorama_luminance() -> Floats:
    """Linear luminance of the panorama, (1024, 2048) array; rows from the north celestial pole, columns: `_looked_up`."""
    try:
        with Image.open(PANORAMA_PATH) as image:
            srgb = np.asarray(image.convert("RGB"), dtype=np.float64) / 255
    except OSError as error:
        raise DataFileError(f"{PANORAMA_PATH}: cannot be read ({error}); reinstall skybench") from error
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return linear @ np.array([0.2126, 0.7152, 0.0722])


@functools.cache
def s10_map() -> NDArray[np.float32]:
    """S10(V) of stars too faint for the catalogue, and diffuse galactic light; layout as :func:`panorama_luminance`."""
    return np.asarray(kept("milky-way", (), lambda: {"s10": _calibrated()})["s10"], dtype=np.float32)


def _calibrated() -> NDArray[np.float32]:
    luminance = panorama_luminance()
    ny, nx = luminance.shape
    turn, polar = (np.arange(nx) + 0.5) * 2 * np.pi / nx, ((np.arange(ny) + 0.5) * np.pi / ny)[:, None]
    across = GALACTIC_POLE[0] * np.sin(turn) + GALACTIC_POLE[1] * np.cos(turn)
    sine = np.sin(polar) * across + np.cos(polar) * GALACTIC_POLE[2]
    least = np.interp(np.abs(sine), np.sin(np.radians(_LATITUDE_DEG)), _LEAST_S10_V)
    return np.maximum(np.interp(luminance, _LUMINANCE, _S10_V), least).astype(np.float32)


@functools.cache
def detailed_map() -> NDArray[np.float32]:
    """:func:`s10_map` with more contrast (DETAIL) and the same mean over the sphere."""
    return np.asarray(kept("milky-way-detail", (), lambda: {"s10": _detailed(s10_map())})["s10"], dtype=np.float32)


def _detailed(table: NDArray[np.float32]) -> NDArray[np.float32]:
    from scipy.ndimage import gaussian_filter1d

    ny, nx = table.shape
    sigma, polar = math.radians(DETAIL_DEG), (np.arange(ny) + 0.5) * np.pi / ny
    # Along a row, a convolution with a Gaussian on the circle is a product in Fourier space, whatever its width.
    waves = np.arange(nx // 2 + 1) * sigma / np.sin(polar)[:, None]
    around = np.fft.irfft(np.fft.rfft(table, axis=1) * np.exp(-0.5 * waves**2), nx, axis=1)
    smooth = gaussian_filter1d(around, sigma * ny / np.pi, axis=0, mode="nearest")
    detailed = np.maximum(smooth + DETAIL * (table - smooth), LEAST_OF_MEAN * smooth)
    return (detailed * (_mean_over_sphere(table) / _mean_over_sphere(detailed))).astype(np.float32)


def _mean_over_sphere(table: NDArray[np.floating]) -> float:
    weight = np.sin((np.arange(len(table)) + 0.5) * np.pi / len(table))
    return float(np.average(table.mean(axis=1), weights=weight))


@functools.cache
def _wrapped_map(deep: bool) -> NDArray[np.float32]:
    """Return the map rotated by half a turn, with its last column before the first and its first after the last."""
    table = detailed_map() if deep else s10_map()
    turned = np.roll(table, table.shape[1] // 2, axis=1)
    return np.concatenate([turned[:, -1:], turned, turned[:, :1]], axis=1)


def s10(icrs: Floats | NDArray[np.float32], deep: bool = False) -> NDArray[np.float32]:
    """S10(V) in directions `icrs` ((..., 3) unit vectors): bilinear in :func:`s10_map` or in :func:`detailed_map`."""
    mi = mitsuba_runtime.start()
    parts = (mi.Float(aligned(np.ascontiguousarray(part, np.float32).ravel())) for part in np.moveaxis(icrs, -1, 0))
    return np.array(_looked_up(deep, *parts)).reshape(icrs.shape[:-1])


def _looked_up(deep: bool, x: Any, y: Any, z: Any) -> Any:
    """S10(V) (Float) in directions (Floats).

    The panorama's columns run along atan2(x, y), its rows along acos(z), of J2000 equatorial unit vectors.
    """
    mi = mitsuba_runtime.start()
    import drjit as dr

    table = _wrapped_map(deep)
    ny, nx = table.shape[0], table.shape[1] - 2
    # After half a turn, no column is negative.
    column = dr.atan2(x, y) * (nx / (2 * np.pi)) + (nx + 1) / 2
    row = dr.clip(dr.acos(dr.clip(z, -1, 1)) * (ny / np.pi) - 0.5, 0, ny - 1.001)
    r0, c0 = dr.floor(row), dr.floor(column)
    first = mi.UInt32(r0) * (nx + 2) + mi.UInt32(c0)

    def along_row(start: Any) -> Any:
        left, right = (dr.gather(mi.Float, _device_map(deep), start + step) for step in (0, 1))
        return dr.lerp(left, right, column - c0)

    upper, lower = along_row(first), along_row(first + (nx + 2))
    return dr.lerp(upper, lower, row - r0)


def sky_mean_s10() -> float:
    """Mean of :func:`s10_map` over the sphere, and of :func:`detailed_map`."""
    return _mean_over_sphere(s10_map())


def counted_s10(faint_limit_v_mag: float = FAINT_LIMIT_V_MAG) -> float:
    """Mean S10(V) over the sky of all stars from V 8.5 to a limit, by published counts."""
    magnitude, count = np.array(CATALOGUE_COUNTS).T
    fine = np.linspace(magnitude[0], faint_limit_v_mag, 200)
    cumulative = np.exp(np.interp(fine, magnitude, np.log(count)))
    middle = (fine[1:] + fine[:-1]) / 2
    return float(np.sum(np.diff(cumulative) * 10 ** (-0.4 * (middle - 10))) / SQUARE_DEGREES)


SQUARE_DEGREES = 4 * np.pi * (180 / np.pi) ** 2


def points_s10(v_mag: Floats) -> float:
    """Mean S10(V) over the sky of stars drawn as points."""
    return float(np.sum(10 ** (-0.4 * (v_mag - 10))) / SQUARE_DEGREES)


def gap_factor(catalogue_v_mag: Floats) -> float:
    """Factor on the map that counts stars between the catalogue and the map exactly once.

    The map contains stars fainter than V 11; the catalogue contains some of those from 8.5 to 11. The light of the rest,
    from published counts, is distributed like the map's.

    Parameters
    ----------
    catalogue_v_mag : (n,) array
        V of the whole catalogue, before any cut by the scenario.
    """
    drawn = points_s10(catalogue_v_mag[catalogue_v_mag > CATALOGUE_COUNTS[0][0]])
    return 1 + max(0.0, counted_s10() - drawn) / sky_mean_s10()


def deep_factor(catalogue_v_mag: Floats, limit_v_mag: float) -> float:
    """Factor on the map for a catalogue that is complete to V 11 and beyond, of which stars to a limit are drawn.

    The light of drawn stars beyond V 11 is subtracted from the map; that of undrawn stars from V 8.5 to 11 is distributed
    like the map.

    Parameters
    ----------
    catalogue_v_mag : (n,) array
        V of the whole catalogue.
    limit_v_mag : float
        V of the faintest drawn star.
    """
    faint = catalogue_v_mag[catalogue_v_mag > CATALOGUE_COUNTS[0][0]]
    left_to_the_map = points_s10(faint[faint <= FAINT_LIMIT_V_MAG]) - points_s10(faint[faint <= limit_v_mag])
    return 1 + left_to_the_map / sky_mean_s10()


@functools.cache
def _device_map(deep: bool) -> Any:
    """:func:`_wrapped_map` as a Float."""
    return mitsuba_runtime.start().Float(_wrapped_map(deep).ravel())


@functools.cache
def _grid_directions() -> tuple[Any, Any, Any]:
    """East, north and up (Floats) of the grid's directions."""
    mi = mitsuba_runtime.start()
    east, north, up = (mi.Float(aligned(part.astype(np.float32))) for part in sky_grid().enu.reshape(-1, 3).T)
    return east, north, up


def _patterns(icrs_from_enu: Floats, factor: float, deep: bool) -> NDArray[np.float32]:
    """S10(V) over the grid, and the part with the galactic centre's colours, (2, ny, nx) array."""
    mi = mitsuba_runtime.start()
    import drjit as dr

    rows = [
        [dr.opaque(mi.Float, float(value)) for value in row]
        for row in (*icrs_from_enu, GALACTIC_CENTRE @ icrs_from_enu)
    ]
    east, north, up = _grid_directions()
    *towards, cosine = (dr.fma(a, east, dr.fma(b, north, c * up)) for a, b, c in rows)
    light = dr.opaque(mi.Float, factor) * _looked_up(deep, *towards)
    squared = dr.square(dr.maximum(cosine, 0))
    redder = light * squared * squared * squared
    dr.eval(light, redder)
    return np.stack([np.array(part).reshape(sky_grid().shape) for part in (light, redder)])


def milky_way(icrs_from_enu: Floats, factor: float, atmosphere: Atmosphere | None, deep: bool = False) -> SkyTable:
    """The diffuse Milky Way at the ground.

    Parameters
    ----------
    icrs_from_enu : (3, 3) array
    factor : float
        :func:`gap_factor` or :func:`deep_factor` of the catalogue in use.
    atmosphere : Atmosphere or None
    deep : bool
        Whether to use :func:`detailed_map`.
    """
    away, centre = (
        star_spectra([S10_MAG_ARCSEC2] * 2, [BV_MAG, CENTRE_BV_MAG], [VI_MAG, CENTRE_VI_MAG]) * ARCSEC2_PER_SR
    )
    patterns = _patterns(icrs_from_enu, factor, deep)
    plain, redder = (above_the_air(patterns[0], spectrum, atmosphere) for spectrum in (away, centre - away))
    return SkyTable(
        np.concatenate([plain.parts, redder.parts]),
        np.concatenate([plain.spectra, redder.spectra]),
        patterns,
    )
