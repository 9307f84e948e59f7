"""A component of the sky as a low-rank table, and the effect of the atmosphere on it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from generator.light.atmosphere import Atmosphere, airmass, scattering_depth
from generator.light.molecular_bands import slant_depth
from generator.light.photometry import BESSELL_V, GRID_NM, surface_brightness_from_radiance
from generator.sky.directions import interpolate, sky_grid, unit_vectors

Floats = NDArray[np.float64]

DIFFUSE_EXTINCTION_FACTOR = 0.75
"""Effective optical depth of diffuse light relative to that of a star: light scattered into a line of sight partly
compensates for light scattered out of it. Source: Kwon et al. 2004, New Astronomy 10, 91; published values run from 0.5 to
0.9."""

EXTINCTION_RANK = 8
COMPRESSION_ERROR = 3e-5


class Veil(Hashable, Protocol):
    """A factor that varies with direction more finely than the grid."""

    def at(self, enu: Floats) -> Floats:
        """Values of the factor, (...) array for (..., 3) unit vectors above the horizon."""


@dataclass(frozen=True, eq=False)
class Dip:
    """Continuation of a component below the horizontal.

    Attributes
    ----------
    lowest_deg : float
        Apparent altitude of the horizon.
    factors : (m, n) array
        Radiance at m evenly spaced altitudes from the horizon up to 0 relative to that at 0, at GRID_NM.
    """

    lowest_deg: float
    factors: Floats


@dataclass(frozen=True, eq=False)
class LowSky:
    """The sky below the horizontal, in the terms of a :class:`SkyTable`.

    Attributes
    ----------
    lowest_deg : float
        Apparent altitude of the horizon.
    maps : (k, m, nx) float32 array
        Maps with rows at m evenly spaced altitudes from the horizon up to 0, and columns as in the grid.
    """

    lowest_deg: float
    maps: NDArray[np.float32]


@dataclass(frozen=True)
class SkyTable:
    """Radiance at the ground as a sum of (direction map) x (spectrum).

    Attributes
    ----------
    parts : (k, ny, nx) or (k, ny, 1) or (k, ny, m) float32 array
        Maps without their common pattern, on :func:`generator.sky.directions.sky_grid`.
    spectra : (k, n) array
        Spectra at GRID_NM; map times spectrum is in photons s^-1 m^-2 nm^-1 sr^-1.
    across : (m, nx) float32 array or None
        Weights of the parts' columns in those of the grid; the parts have only m columns because a smooth component needs
        no more.
    pattern : (ny, nx) or (ny, 1) or (p, ny, nx) float32 array or None
        Common factor of all maps; None means 1. A component seen through the air is a pattern times a few profiles in
        altitude, which takes much less computation than the maps. With p patterns, the first p-th of the maps is to be
        multiplied by the first, and so on.
    veiled : tuple of (Veil, SkyTable)
        Further light; each table is to be multiplied by its veil in each direction.
    dip : Dip or None
        Continuation of a component below the horizontal; None if it ends there.
    low : LowSky or None
        The light below the horizontal, including that behind veils, in the terms of `parts`.
    """

    parts: NDArray[np.float32]
    spectra: Floats
    pattern: NDArray[np.float32] | None = None
    veiled: tuple[tuple[Veil, SkyTable], ...] = ()
    dip: Dip | None = None
    low: LowSky | None = None
    across: NDArray[np.float32] | None = None

    @property
    def maps(self) -> NDArray[np.float32]:
        """The direction maps without the veiled light, (k, ny, nx) array."""
        return np.broadcast_to(self.whole_parts, (len(self.parts), *sky_grid().shape))

    @property
    def whole_parts(self) -> NDArray[np.float32]:
        """The parts times their pattern, (k, ny, nx) or, if nothing depends on the azimuth, (k, ny, 1) array."""
        return self.wide_parts if self.pattern is None else self.wide_parts * self._pattern_by_part

    @property
    def wide_parts(self) -> NDArray[np.float32]:
        """The parts with all columns of the grid, or with one, (k, ny, nx) or (k, ny, 1) array."""
        return self.parts if self.across is None else self.parts @ self.across

    @property
    def azimuth_mean(self) -> Floats:
        """Mean of each map over azimuth, without the veiled light, (k, ny) array."""
        if self.pattern is None:
            across = None if self.across is None else self.across.mean(axis=1)
            return np.asarray(self.parts.mean(axis=2) if across is None else self.parts @ across, dtype=np.float64)
        patterns = self.pattern.reshape(-1, *self.pattern.shape[-2:])
        if self.across is not None:
            patterns = patterns @ self.across.T
        each = len(self.parts) // len(patterns)
        groups = self.parts.reshape(len(patterns), each, *self.parts.shape[1:])
        if self.parts.shape[2] == 1:
            means = groups[..., 0] * patterns.mean(axis=2)[:, None]
        else:
            columns = sky_grid().shape[1] if self.across is not None else self.parts.shape[2]
            means = np.einsum("pkrm,prm->pkr", groups, np.broadcast_to(patterns, groups[:, 0].shape)) / columns
        return np.asarray(means.reshape(len(self.parts), -1), dtype=np.float64)

    @property
    def _pattern_by_part(self) -> NDArray[np.float32]:
        """The pattern, one for each map if there are several; requires a pattern."""
        assert self.pattern is not None
        if self.pattern.ndim == 2:
            return self.pattern
        return np.repeat(self.pattern, len(self.parts) // len(self.pattern), axis=0)

    def scaled(self, factor: float) -> SkyTable:
        """Return the table multiplied by a number."""
        veiled = tuple((veil, table.scaled(factor)) for veil, table in self.veiled)
        return dataclasses.replace(self, spectra=self.spectra * factor, veiled=veiled)

    def behind(self, veil: Veil) -> SkyTable:
        """Return the table, which has no veiled light yet, seen through a veil."""
        return dataclasses.replace(black_sky(), veiled=((veil, self),))

    def weighted(self, weights: Floats) -> NDArray[np.float32]:
        """Maps of weighted sums over the spectrum, without the veiled light.

        Parameters
        ----------
        weights : (c, n) array
            At GRID_NM.

        Returns
        -------
        (c, ny, nx) array
            Sum over the terms and GRID_NM of map x spectrum x weight.
        """
        mix = (weights @ self.spectra.T).astype(np.float32)
        # BLAS threads wait for each other in busy loops: on a machine with busy cores, one thread is several times
        # faster.
        with blas_threads().limit(limits=1, user_api="blas"):
            patterns = (None,) if self.pattern is None else self.pattern.reshape(-1, *self.pattern.shape[-2:])
            each = len(self.parts) // len(patterns)
            result: NDArray[np.float32] | None = None
            for pattern, start in zip(patterns, range(0, len(self.parts), each), strict=True):
                group = slice(start, start + each)
                light = np.tensordot(mix[:, group], self.parts[group], axes=1)
                light = light if self.across is None else light @ self.across
                light = light if pattern is None else _in_place(np.multiply, light, pattern)
                result = light if result is None else _in_place(np.add, result, light)
            assert result is not None
        return np.broadcast_to(result, (len(weights), *sky_grid().shape))

    def signal(self, weights: Floats, altitude_deg: Floats, azimuth_deg: Floats) -> Floats:
        """Weighted sums over the spectrum in m directions, (c, m) array for (c, n) weights; those at the horizon below it."""
        light = (weights @ self.spectra.T) @ interpolate(self.maps, altitude_deg, azimuth_deg)
        for veil, table in self.veiled:
            enu = unit_vectors(np.clip(altitude_deg, 0, 90), azimuth_deg)
            light = light + table.signal(weights, altitude_deg, azimuth_deg) * veil.at(enu)
        return light

    def radiance(self, altitude_deg: Floats, azimuth_deg: Floats) -> Floats:
        """Radiance in m directions, (m, n) array; zero below the horizon."""
        light = self.signal(np.eye(len(GRID_NM)), altitude_deg, azimuth_deg).T
        return np.where(np.asarray(altitude_deg)[:, None] >= 0, light, 0.0)

    def v_mag_arcsec2(self, altitude_deg: Floats, azimuth_deg: Floats) -> Floats:
        """Surface brightness in m directions, V mag/arcsec^2, (m,) array."""
        light = self.signal(v_band()[None], altitude_deg, azimuth_deg)[0]
        return surface_brightness_from_radiance(np.maximum(light, 1e-30))

    def zenith_v(self) -> float:
        """V-band mean photon radiance of the zenith, photons s^-1 m^-2 nm^-1 sr^-1."""
        zenith = self.parts[:, -1, 0] if self.across is None else self.parts[:, -1] @ self.across[:, 0]
        if self.pattern is not None:
            overhead_by_pattern = self.pattern[..., -1, 0].reshape(-1)
            zenith = zenith * np.repeat(overhead_by_pattern, len(self.parts) // len(overhead_by_pattern))
        veiled = sum(_overhead(veil) * table.zenith_v() for veil, table in self.veiled)
        return float(v_band() @ self.spectra.T @ zenith) + veiled


@functools.lru_cache(maxsize=2)
def _overhead(veil: Veil) -> float:
    """A veil's factor at the zenith, cached because the components of a sky share their veils."""
    return float(veil.at(np.array([[0.0, 0.0, 1.0]]))[0])


@functools.cache
def v_band() -> Floats:
    """Weights of the mean over the V band at GRID_NM, (n,) array."""
    return np.asarray(BESSELL_V.mean(GRID_NM, np.eye(len(GRID_NM))))


def _in_place(operation: np.ufunc, values: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float32]:
    """Apply an operation to two arrays, in place of the first if it has the result's shape."""
    fits = np.broadcast_shapes(values.shape, other.shape) == values.shape
    return np.asarray(operation(values, other, out=values if fits else None))


def black_sky() -> SkyTable:
    """A sky without light."""
    return SkyTable(np.zeros((1, sky_grid().shape[0], 1), np.float32), np.zeros((1, len(GRID_NM))))


def total(tables: Sequence[SkyTable]) -> SkyTable:
    """Sum of components, uncompressed."""
    if not tables:
        return black_sky()
    parts = [table.whole_parts for table in tables]
    width = max(part.shape[2] for part in parts)
    wide = [np.broadcast_to(part, (*part.shape[:2], width)) for part in parts]
    veiled = tuple((veil, total(behind)) for veil, behind in by_veil(tables))
    return SkyTable(np.concatenate(wide), np.concatenate([t.spectra for t in tables]), veiled=veiled)


def side_by_side(tables: Sequence[SkyTable]) -> SkyTable:
    """Sum of components with equally many parts that do not depend on azimuth, each with its pattern and without veils."""
    patterns = [np.ones((1, 1), np.float32) if table.pattern is None else table.pattern for table in tables]
    return SkyTable(
        np.concatenate([table.parts for table in tables]),
        np.concatenate([table.spectra for table in tables]),
        np.stack([np.broadcast_to(pattern, sky_grid().shape) for pattern in patterns]),
    )


def by_veil(tables: Sequence[SkyTable]) -> list[tuple[Veil, list[SkyTable]]]:
    """Return the veils of some tables, and everything behind each."""
    groups: dict[Veil, list[SkyTable]] = {}
    for table in tables:
        for veil, behind in table.veiled:
            groups.setdefault(veil, []).append(behind)
    return list(groups.items())


def metameric(tables: Sequence[SkyTable], response: Floats) -> SkyTable:
    """Return a sky with one term per channel that a camera cannot distinguish from the sum of some components.

    Parameters
    ----------
    tables : sequence of SkyTable
    response : (channels, n) array
        Response of each channel at GRID_NM; the sum of response times spectrum is its signal.

    Returns
    -------
    SkyTable
        Each map is a channel's signal, and each spectrum is the smallest with a signal of 1 in its channel and of 0 in
        the others; it may be negative in places.
    """
    if not tables:
        return black_sky()
    spectra: Floats = np.linalg.pinv(response).T.astype(np.float64)

    def signals(some: Sequence[SkyTable]) -> SkyTable:
        maps = np.zeros((len(response), *sky_grid().shape), np.float32)
        for table in some:
            maps += table.weighted(response)
        return SkyTable(maps, spectra)

    veiled = tuple((veil, signals(behind)) for veil, behind in by_veil(tables))
    return dataclasses.replace(signals(tables), veiled=veiled, low=_low_signals(tables, response))


def with_dip(table: SkyTable, dip: Dip) -> SkyTable:
    """Return a table, including its veiled light, that continues below the horizontal."""
    veiled = tuple((veil, with_dip(behind, dip)) for veil, behind in table.veiled)
    return dataclasses.replace(table, veiled=veiled, dip=dip)


def _low_signals(tables: Sequence[SkyTable], response: Floats) -> LowSky | None:
    """Signals of the channels below the horizontal, where a veil is as thick as at the horizontal."""
    maps, lowest_deg = None, 0.0
    level = unit_vectors(np.zeros(sky_grid().shape[1]), sky_grid().azimuth_deg)
    for table in tables:
        if table.dip is None:
            continue
        lowest_deg = table.dip.lowest_deg
        light = np.zeros((len(response), len(table.dip.factors), sky_grid().shape[1]))
        for veil, part in ((None, table), *table.veiled):
            mix = np.einsum("cn,mn,kn->cmk", response, table.dip.factors, part.spectra, optimize=True)
            seen = mix @ part.maps[:, 0].astype(np.float64)
            light += seen if veil is None else seen * veil.at(level)
        maps = light if maps is None else maps + light
    return None if maps is None else LowSky(lowest_deg, maps.astype(np.float32))


@functools.cache
def blas_threads() -> ThreadpoolController:
    """Control of the threads of NumPy's linear algebra (finding the libraries takes some milliseconds, once)."""
    return ThreadpoolController()


def compressed(table: SkyTable) -> SkyTable:
    """Return the same sky with the fewest terms that keep every spectrum to COMPRESSION_ERROR of the brightest one.

    The spectra, each weighted by its map's largest value, are replaced by their leading singular vectors, which are
    common to the light behind all veils.
    """
    groups = [table, *(behind for _, behind in table.veiled)]
    maps = [group.maps for group in groups]
    weight = np.concatenate([np.abs(part).max(axis=(1, 2)) for part in maps]).astype(float)
    if not weight.any():
        return black_sky()
    weighted = np.concatenate([group.spectra for group in groups]) * weight[:, None]
    left, size, right = np.linalg.svd(weighted, full_matrices=False)
    keep = max(1, int(np.sum(size > COMPRESSION_ERROR * size[0])))
    mix = (left[:, :keep] * size[:keep]).T / np.where(weight > 0, weight, np.inf)
    few, start = [], 0
    for part in maps:
        own = mix[:, start : start + len(part)].astype(np.float32)
        start += len(part)
        # BLAS threads wait for each other in busy loops: on a machine with busy cores, one thread is several times
        # faster.
        with blas_threads().limit(limits=1, user_api="blas"):
            few.append(SkyTable(np.tensordot(own, part, axes=1), right[:keep]))
    veils = [veil for veil, _ in table.veiled]
    return dataclasses.replace(few[0], veiled=tuple(zip(veils, few[1:], strict=True)))


def low_rank(table: Floats, rank: int) -> tuple[Floats, Floats]:
    """Return the best sum of `rank` products a(row) x b(column) for a table: a (rank, rows), b (rank, columns).

    It uses the eigenvectors of the small Gram matrix, which on a busy machine is a thousand times faster than LAPACK's SVD.
    """
    _, vectors = np.linalg.eigh(table.T @ table)
    right = vectors[:, ::-1][:, :rank].T
    return (table @ right.T).T, right


@functools.lru_cache(maxsize=32)
def extinction_factors(atmosphere: Atmosphere | None, factor: float) -> tuple[Floats, Floats]:
    """Return exp(-factor x scattering depth x airmass - absorption) as a sum of products, a(altitude) x b(wavelength).

    Returns
    -------
    a : (r, ny) array
        Factors at the grid's altitudes.
    b : (r, n) array
        Factors at GRID_NM. The sum differs from the transmission by less than 1e-4.
    """
    if atmosphere is None:
        return np.ones((1, len(sky_grid().altitude_deg))), np.ones((1, len(GRID_NM)))
    path = airmass(sky_grid().altitude_deg)
    # Absorption by ozone and in bands is not compensated by light that is scattered in.
    absorbed = slant_depth(GRID_NM, atmosphere, path) - path[:, None] * scattering_depth(GRID_NM, atmosphere)
    transmission = np.exp(-factor * path[:, None] * scattering_depth(GRID_NM, atmosphere) - absorbed)
    return low_rank(transmission, EXTINCTION_RANK)


def above_the_air(
    direction_map: Floats | NDArray[np.float32],
    spectrum: Floats,
    atmosphere: Atmosphere | None,
    factor: float = DIFFUSE_EXTINCTION_FACTOR,
) -> SkyTable:
    """Return light from above the atmosphere as seen from the ground.

    Parameters
    ----------
    direction_map : (ny, nx) or (ny, 1) array
    spectrum : (n,) array
        Map times spectrum is the radiance above the atmosphere.
    atmosphere : Atmosphere or None
        Dimming air; None for no extinction.
    factor : float
        Ratio of effective to true optical depth.
    """
    a, b = extinction_factors(atmosphere, factor)
    return SkyTable(a[:, :, None].astype(np.float32), spectrum * b, direction_map.astype(np.float32))
