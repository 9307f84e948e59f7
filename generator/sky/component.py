"""A component of the sky as a low-rank table, and what the atmosphere does to it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from generator.atmosphere import Atmosphere, airmass, optical_depth
from generator.photometry import BESSELL_V, GRID_NM, surface_brightness_from_radiance
from generator.sky.directions import interpolate, sky_grid

Floats = NDArray[np.float64]

DIFFUSE_EXTINCTION_FACTOR = 0.75
"""Effective optical depth of diffuse light over that of a star: light scattered out of one line of sight is partly made up
for by light scattered in. Source: Kwon et al. 2004, New Astronomy 10, 91; published values run from 0.5 to 0.9."""

EXTINCTION_RANK = 6
COMPRESSION_ERROR = 3e-5


@dataclass(frozen=True)
class SkyTable:
    """Radiance at the ground as a sum of (direction map) x (spectrum).

    Attributes
    ----------
    parts : (k, ny, nx) or (k, ny, 1) float32 array
        Maps without their common pattern, on :func:`generator.sky.directions.sky_grid`.
    spectra : (k, n) array
        At GRID_NM; map times spectrum is in photons s^-1 m^-2 nm^-1 sr^-1.
    pattern : (ny, nx) or (ny, 1) float32 array or None
        What all maps are to be multiplied with; None: 1. A component seen through the air is a pattern times a few
        profiles in altitude, which is much less to compute with than the maps.
    """

    parts: NDArray[np.float32]
    spectra: Floats
    pattern: NDArray[np.float32] | None = None

    @property
    def maps(self) -> NDArray[np.float32]:
        """The direction maps, (k, ny, nx) array."""
        whole = self.parts if self.pattern is None else self.parts * self.pattern
        return np.broadcast_to(whole, (len(whole), *sky_grid().shape))

    def scaled(self, factor: float | NDArray[np.float32]) -> SkyTable:
        """The same times a number, or times a map (ny, nx)."""
        if np.ndim(factor) == 0:
            return SkyTable(self.parts, self.spectra * factor, self.pattern)
        pattern = np.asarray(factor, np.float32)
        return SkyTable(self.parts, self.spectra, pattern if self.pattern is None else self.pattern * pattern)

    def weighted(self, weights: Floats) -> NDArray[np.float32]:
        """Maps of weighted sums over the spectrum.

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
        # BLAS threads wait for each other in busy loops: on a machine whose cores are taken, one is several times faster.
        with blas_threads().limit(limits=1, user_api="blas"):
            result = np.tensordot(mix, self.parts, axes=1)
        if self.pattern is not None:
            result = result * self.pattern
        return np.broadcast_to(result, (len(weights), *sky_grid().shape))

    def radiance(self, altitude_deg: Floats, azimuth_deg: Floats) -> Floats:
        """Radiance from m directions, (m, n) array; zero below the horizon."""
        values = interpolate(self.maps, altitude_deg, azimuth_deg)
        return np.where(np.asarray(altitude_deg)[:, None] >= 0, values.T @ self.spectra, 0.0)

    def v_mag_arcsec2(self, altitude_deg: Floats, azimuth_deg: Floats) -> Floats:
        """Surface brightness of m directions, V mag/arcsec^2, (m,) array."""
        values = interpolate(self.maps, altitude_deg, azimuth_deg)
        return surface_brightness_from_radiance(np.maximum(BESSELL_V.mean(GRID_NM, self.spectra) @ values, 1e-30))

    def zenith_v(self) -> float:
        """V-band mean photon radiance of the zenith, photons s^-1 m^-2 nm^-1 sr^-1."""
        zenith = self.parts[:, -1, 0] * (1 if self.pattern is None else self.pattern[-1, 0])
        return float(BESSELL_V.mean(GRID_NM, self.spectra) @ zenith)


def black_sky() -> SkyTable:
    """A sky without light."""
    return SkyTable(np.zeros((1, sky_grid().shape[0], 1), np.float32), np.zeros((1, len(GRID_NM))))


def total(tables: Sequence[SkyTable]) -> SkyTable:
    """Sum of components, uncompressed."""
    if not tables:
        return black_sky()
    parts = [t.parts if t.pattern is None else t.parts * t.pattern for t in tables]
    width = max(part.shape[2] for part in parts)
    wide = [np.broadcast_to(part, (*part.shape[:2], width)) for part in parts]
    return SkyTable(np.concatenate(wide), np.concatenate([t.spectra for t in tables]))


def metameric(tables: Sequence[SkyTable], response: Floats) -> SkyTable:
    """A sky with one term per channel that a camera cannot tell from the sum of some components.

    Parameters
    ----------
    tables : sequence of SkyTable
    response : (channels, n) array
        What each channel makes of light at GRID_NM; the sum of response times spectrum is its signal.

    Returns
    -------
    SkyTable
        Each map is a channel's signal, each spectrum the smallest that makes a signal of 1 in its channel and of 0 in the
        others; it may be negative in places.
    """
    if not tables:
        return black_sky()
    maps = np.zeros((len(response), *sky_grid().shape), np.float32)
    for table in tables:
        maps += table.weighted(response)
    spectra: Floats = np.linalg.pinv(response).T.astype(np.float64)
    return SkyTable(maps, spectra)


@functools.cache
def blas_threads() -> ThreadpoolController:
    """Control of the threads of NumPy's linear algebra (finding the libraries takes some milliseconds, once)."""
    return ThreadpoolController()


def compressed(table: SkyTable) -> SkyTable:
    """The same sky with as few terms as keep every spectrum to COMPRESSION_ERROR of the brightest one.

    The spectra, each weighted by its map's largest value, are replaced by their leading singular vectors.
    """
    maps = table.maps
    weight = np.abs(maps).max(axis=(1, 2)).astype(float)
    used = weight > 0
    if not used.any():
        return black_sky()
    weighted = table.spectra[used] * weight[used, None]
    left, size, right = np.linalg.svd(weighted, full_matrices=False)
    keep = max(1, int(np.sum(size > COMPRESSION_ERROR * size[0])))
    mix = (left[:, :keep] * size[:keep]).T / weight[used]
    # BLAS threads wait for each other in busy loops: on a machine whose cores are taken, one is several times faster.
    with blas_threads().limit(limits=1, user_api="blas"):
        few = np.tensordot(mix.astype(np.float32), maps[used], axes=1)
    return SkyTable(few, right[:keep])


def low_rank(table: Floats, rank: int) -> tuple[Floats, Floats]:
    """The best sum of `rank` products a(row) x b(column) for a table: a (rank, rows), b (rank, columns).

    By the eigenvectors of the small Gram matrix, which on a busy machine is a thousand times faster than LAPACK's SVD.
    """
    _, vectors = np.linalg.eigh(table.T @ table)
    right = vectors[:, ::-1][:, :rank].T
    return (table @ right.T).T, right


@functools.lru_cache(maxsize=32)
def extinction_factors(atmosphere: Atmosphere | None, factor: float) -> tuple[Floats, Floats]:
    """Transmission exp(-factor x depth x airmass) as a sum of products, a(altitude) x b(wavelength).

    Returns
    -------
    a : (r, ny) array
        On the grid's altitudes.
    b : (r, n) array
        At GRID_NM. The sum differs from the transmission by less than 1e-4.
    """
    if atmosphere is None:
        return np.ones((1, len(sky_grid().altitude_deg))), np.ones((1, len(GRID_NM)))
    path = airmass(sky_grid().altitude_deg)
    transmission = np.exp(-factor * path[:, None] * optical_depth(GRID_NM, atmosphere))
    return low_rank(transmission, EXTINCTION_RANK)


def above_the_air(
    direction_map: Floats | NDArray[np.float32],
    spectrum: Floats,
    atmosphere: Atmosphere | None,
    factor: float = DIFFUSE_EXTINCTION_FACTOR,
) -> SkyTable:
    """Light from above the atmosphere as it is seen from the ground.

    Parameters
    ----------
    direction_map : (ny, nx) or (ny, 1) array
    spectrum : (n,) array
        Map times spectrum is the radiance above the atmosphere.
    atmosphere : Atmosphere or None
        None: no extinction.
    factor : float
        Effective over true optical depth.
    """
    a, b = extinction_factors(atmosphere, factor)
    return SkyTable(a[:, :, None].astype(np.float32), spectrum * b, direction_map.astype(np.float32))
