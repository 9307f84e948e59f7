"""Light transmitted by an infinite, conservatively scattering layer: all orders of scattering, by doubling.

Source: Hansen & Travis 1974, Space Sci. Rev. 16, 527, after van de Hulst, for each Fourier term in azimuth.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from generator.light.cloud_phase import ray_phase
from generator.sky.component import blas_threads

Floats = NDArray[np.float64]

STREAMS = 24
"""Number of Gaussian points of the cosine, from 0 to 1."""
TERMS = 24
"""Number of Fourier terms in azimuth; light scattered more than once is smooth."""
TURNS = 128
"""Number of azimuths from which the terms of the phase function are computed."""
FIRST_DEPTHS = 2.0**-20, 2.0**-19.5
"""Optical depths of the layers from which two series of doublings start; they scatter once."""
KEPT_FROM, KEPT_TO = 2.0**-10, 2.0**8
"""Range of optical depths at which results are kept."""


@dataclass(frozen=True, eq=False)
class LayerTransfer:
    """Light transmitted by layers after more than one scattering.

    Attributes
    ----------
    cosines : (n,) array
        Cosines of the line of sight and of the source, from the vertical.
    depths : (d,) array
        Vertical optical depths.
    more : (d, TERMS, n, n) array
        Fourier terms of the transmission function by line of sight and source, less the light scattered once.
    albedo : (d, n) array
        Fraction of a source's light that each layer reflects.
    """

    cosines: Floats
    depths: Floats
    more: Floats
    albedo: Floats

    def radiance(self, cosine: float, depths: Floats, views: Floats, turns: Floats) -> Floats:
        """Radiance over irradiance, sr^-1, of light scattered more than once, (depths, views, turns) array.

        Parameters
        ----------
        cosine : float
            Cosine of the source.
        depths : (d,) array
            Vertical optical depths, from 0 to KEPT_TO.
        views : (v,) array
            Cosines of lines of sight.
        turns : (t,) array
            Azimuths from the source's, rad.
        """
        source, seen = (_spline_weights(self.cosines, at) for at in (np.atleast_1d(cosine), views))
        waves = np.cos(np.arange(TERMS)[:, None] * turns) * np.where(np.arange(TERMS) == 0, 1, 2)[:, None]
        # Light scattered twice is proportional to the square of the depth, so the interpolated quantity is nearly
        # constant.
        kept, wanted = (depth**2 / (1 + depth**2) for depth in (self.depths, depths))
        between = _spline_weights(np.log(self.depths), np.log(np.clip(depths, self.depths[0], self.depths[-1])))
        by_view = np.einsum("vn,dmn->dvm", seen, self.more @ source[0])
        flat = np.tensordot(between, (by_view / kept[:, None, None]) @ waves, axes=1)
        return np.asarray(cosine / np.pi * np.maximum(flat * wanted[:, None, None], 0))


def _spline_weights(nodes: Floats, places: Floats) -> Floats:
    """Weights of the values at nodes in a cubic spline's values at places, (places, nodes)."""
    return np.asarray(CubicSpline(nodes, np.eye(len(nodes)))(places))


def layer_transfer(phase: Callable[[Floats], Floats]) -> LayerTransfer:
    """Transfer through layers with a phase function of the angle (rad), sr^-1."""
    node, weight = np.polynomial.legendre.leggauss(STREAMS)
    cosines, weights = (node + 1) / 2, weight / 2
    forwards, backwards = (_terms(phase, cosines, side) for side in (1.0, -1.0))
    # Light that the quadrature loses or creates would be counted again in each doubling.
    total = (weights[:, None] * (forwards[0] + backwards[0])).sum(axis=0) / 2
    scale = 1 / np.sqrt(total[:, None] * total)
    for _ in range(20):
        total = (weights[:, None] * scale * (forwards[0] + backwards[0])).sum(axis=0) / 2
        scale /= np.sqrt(total[:, None] * total)
    forwards[0] *= scale
    backwards[0] *= scale
    series = (_doubled(first, forwards, backwards, cosines, weights) for first in FIRST_DEPTHS)
    by_depth = sorted((kept for each in series for kept in each), key=lambda kept: kept[0])
    depths, more, albedo = (np.array([kept[k] for kept in by_depth]) for k in range(3))
    return LayerTransfer(cosines, depths, more, albedo)


def _terms(phase: Callable[[Floats], Floats], cosines: Floats, side: float) -> Floats:
    """Fourier terms of a phase function (mean 1) between directions on the same side or on opposite ones, (TERMS, n, n)."""
    turn = 2 * np.pi * np.arange(TURNS) / TURNS
    sines = np.sqrt(1 - cosines**2)
    together = side * cosines[:, None, None] * cosines[:, None] + sines[:, None, None] * sines[:, None] * np.cos(turn)
    values = 4 * np.pi * phase(np.arccos(np.clip(together, -1, 1)))
    return np.ascontiguousarray(np.moveaxis(np.fft.rfft(values).real / TURNS, -1, 0)[:TERMS])


def scattered_once(view_path: ArrayLike, source_path: ArrayLike) -> Floats:
    """Radiance of light scattered once downwards through a layer, divided by phase function and irradiance.

    The arguments are the optical depths p and q along the line of sight and along the path from the source. The result is
    p (exp(-q) - exp(-p)) / (p - q) (Chandrasekhar 1950, section 7).
    """
    view, source = np.asarray(view_path, dtype=np.float64), np.asarray(source_path, dtype=np.float64)
    # Formulated with the shorter path, so that nothing overflows.
    gap = np.abs(view - source)
    small = gap < 1e-6
    mean = np.where(small, 1 - gap / 2, -np.expm1(-gap) / np.where(small, 1, gap))
    return np.asarray(view * np.exp(-np.minimum(view, source)) * mean)


def _once(depth: float, cosines: Floats) -> tuple[Floats, Floats]:
    """Reflection and transmission functions of light scattered once, for a phase function of mean 1, (n, n) each."""
    out, into = cosines[:, None], cosines
    back = -np.expm1(-depth * (1 / out + 1 / into)) / (4 * (out + into))
    return back, scattered_once(depth / out, depth / into) / (4 * into)


def _doubled(
    first: float, forwards: Floats, backwards: Floats, cosines: Floats, weights: Floats
) -> list[tuple[float, Floats, Floats]]:
    """Layers of doubled depths that are kept: depth, transmission without light scattered once, and albedo."""
    measure = 2 * cosines * weights
    kept = []
    depth = first
    back, through = _once(depth, cosines)
    reflected, passed = backwards * back, forwards * through
    while depth <= KEPT_TO:
        if depth >= KEPT_FROM:
            albedo = (measure[:, None] * reflected[0]).sum(axis=0)
            kept.append((depth, passed - forwards * _once(depth, cosines)[1], albedo))
        direct = np.exp(-depth / cosines)
        twice = (reflected * measure) @ reflected
        between = np.linalg.solve(np.eye(STREAMS) - twice * measure, twice)
        down = passed + between * direct + (between * measure) @ passed
        up = reflected * direct + (reflected * measure) @ down
        reflected = reflected + direct[:, None] * up + (passed * measure) @ up
        passed = direct[:, None] * down + passed * direct + (passed * measure) @ down
        depth *= 2
    return kept


@functools.lru_cache(maxsize=2)
def cloud_transfer(ice: bool) -> LayerTransfer:
    """Transfer through cloud of crystals or droplets, for depths without the diffracted part."""
    # BLAS threads wait for each other in busy loops: for matrices this small, one thread is many times faster.
    with blas_threads().limit(limits=1, user_api="blas"):
        return layer_transfer(lambda angle: ray_phase(angle, ice))
