"""Where the middles of streaks are, by their ends.

A streak is a line under a Gaussian, as in the trail fitting of Veres et al. (2012, PASP 124, 1197). Along it
the light is the same everywhere but at its ends, which alone say where it lies: with a pixel's noise n and
a ridge of height a the middle is known to n / a, whatever the length (the Cramér-Rao bound of a line under a Gaussian),
where the centroid under a Gaussian of the streak's length, of which the ends are left out, scatters three times as much.

A streak's profile is compared with lines at all shifts, and the mean over their likelihoods is its middle: so it is
uncertain as the streak is faint, up to the whole range where noise hides the ends. One length for all, as a factor on the
shape's, is that under which the streaks stand out most.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.correlation.streak import GAUSSIAN_OF_LINE
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.star_centroids import CENTROID_FLOOR_PX, Measured
from celnav.detecting.star_shape import axes

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# A streak is so many times longer than wide, by the axes' variances; below, the ends are as wide as it is long.
_LONG, _FEWEST = 9.0, 4
# Profiles go so far beyond the shape's ends, and shifts as far from where the streak was found: a part of the length, px.
_BEYOND, _BEYOND_PX = 0.35, 2.0
_LENGTHS = np.arange(0.7, 1.451, 0.025)
# Steps of profiles and of shifts, px.
_STEP_PX, _SHIFT_PX = 0.5, 0.2
# A streak counts for the length as one of such a significance, squared and halved, does at most. So many tell it.
_MOST, _TELLING = 200.0, 256
# Streaks that are measured at a time.
_AT_ONCE = 256


class _Profiles(NamedTuple):
    """Light along streaks, in units of their lengths.

    Attributes
    ----------
    at : ndarray, shape (t,)
        Places along the streaks, over their lengths.
    light : ndarray, shape (n, t)
        Sum across the streak with the weights of its width.
    inside : ndarray, shape (n, t)
        1 in the image, 0 beyond.
    scale : ndarray, shape (n,)
        Noise of a profile's value over that of a pixel, with the pixels that a step stands for.
    """

    at: F8
    light: F8
    inside: F8
    scale: F8


def by_ends(light: F4, noise: NoiseMap, stars: Measured, covariance: F8, gain_e_per_unit: float) -> Measured:
    """Measure anew where stars are that have left streaks; the others, and all where few have, stay.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image less background.
    noise : NoiseMap
        Standard deviation of its pixels without stars.
    stars : Measured
        Centroids under the stars' own windows.
    covariance : ndarray, shape (n, 3)
        Of the stars' images: uu, uv, vv, px^2.
    gain_e_per_unit : float
        Electrons that make one unit of the image.
    """
    large, small = axes(covariance)
    long = np.flatnonzero(large > _LONG * small)
    if len(long) < _FEWEST:
        return stars
    large, small, (uu, uv, vv) = large[long], small[long], covariance[long].T
    turn = np.arctan2(2 * uv, uu - vv) / 2
    along = np.column_stack((np.cos(turn), np.sin(turn)))
    length, width = np.sqrt(GAUSSIAN_OF_LINE * (large - small)), np.sqrt(small)
    found = stars.uv[long]
    rows, columns = np.rint(found[:, ::-1]).astype(np.intp).T
    size = light.shape
    pixel = noise.at(rows.clip(0, size[0] - 1), columns.clip(0, size[1] - 1)).astype(np.float64)
    typical = float(np.median(length))
    reach = _BEYOND + _BEYOND_PX / typical
    shifts = np.arange(-reach, reach, _SHIFT_PX / typical)
    half = 0.5 * _LENGTHS[-1] + _BEYOND + 2 * _BEYOND_PX / typical
    along_at = np.arange(-half, half, _STEP_PX / typical)
    edge = float(np.median(width / length))
    telling = np.linspace(0, len(long) - 1, min(len(long), _TELLING)).astype(np.intp)
    profiles = _profiles(light, found[telling], along[telling], length[telling], width[telling], along_at)
    best = np.array([_fit(profiles, factor, edge, shifts, pixel[telling])[0].max(axis=1) for factor in _LENGTHS])
    # No bright one decides.
    counted = np.minimum(1, _MOST / np.maximum(best.max(axis=0), 1e-30))
    factor = float(_LENGTHS[np.argmax(best @ counted)])
    placed = []
    for start in range(0, len(long), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        profiles = _profiles(light, found[part], along[part], length[part], width[part], along_at)
        placed.append(_placed(*_fit(profiles, factor, edge, shifts, pixel[part]), shifts))
    shift, spread, ridge = np.concatenate(placed, axis=1)
    spread *= length
    # At the ends half of the ridge's light scatters too. Across a streak positions are better by far.
    spread = np.sqrt(spread**2 + 1 / (2 * ridge * gain_e_per_unit) + _SHIFT_PX**2 / 12)
    moved = found + (shift * length)[:, None] * along
    inside = ((moved >= 0) & (moved <= np.array([size[1], size[0]]) - 1)).all(axis=1)
    at, sigma = stars.uv.copy(), stars.sigma_px.copy()
    at[long[inside]] = moved[inside]
    sigma[long[inside]] = np.hypot(spread[inside] / np.sqrt(2), CENTROID_FLOOR_PX)
    return replace(stars, uv=at, sigma_px=sigma)


def _placed(likelihood: F8, ridge: F8, shifts: F8) -> F8:
    """Mean of the shifts of each streak over their likelihoods, its scatter, and the ridge at the likeliest; shape (3, n)."""
    weight = np.exp(likelihood - likelihood.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    shift = weight @ shifts
    spread = np.sqrt(np.maximum(weight @ shifts**2 - shift**2, 0))
    ridge = np.maximum(np.take_along_axis(ridge, likelihood.argmax(axis=1)[:, None], axis=1)[:, 0], 1e-30)
    return np.stack((shift, spread, ridge))


def _profiles(light: F4, uv: F8, along: F8, length: F8, width: F8, at: F8) -> _Profiles:
    """Read the light along streaks at places `at`, shape (t,), over their lengths."""
    from scipy import ndimage

    reach = max(2, int(np.ceil(2.5 * width.max())))
    beside = np.arange(-reach, reach + 1.0)
    far = (at * length[:, None])[:, :, None]
    columns = uv[:, 0, None, None] + far * along[:, 0, None, None] - beside * along[:, 1, None, None]
    rows = uv[:, 1, None, None] + far * along[:, 1, None, None] + beside * along[:, 0, None, None]
    weights = np.exp(-0.5 * (beside / width[:, None]) ** 2)
    values = ndimage.map_coordinates(light, [rows, columns], order=1, mode="constant")
    middle = (rows[:, :, reach], columns[:, :, reach])
    inside = (middle[0] >= 0) & (middle[0] <= light.shape[0] - 1) & (middle[1] >= 0) & (middle[1] <= light.shape[1] - 1)
    step = (at[1] - at[0]) * length
    across = (weights**2).sum(axis=1)
    summed = np.einsum("nty,ny->nt", values, weights) * inside / across[:, None]
    return _Profiles(at, summed, inside.astype(np.float64), 1 / np.sqrt(across * step))


def _fit(profiles: _Profiles, factor: float, edge: float, shifts: F8, noise: F8) -> tuple[F8, F8]:
    """Fit lines of a length, in those of the shape, with ends so soft, and a level to each profile at all shifts.

    Returns
    -------
    likelihood : ndarray, shape (n, s)
        Logarithm, but for a constant: the square of the line's significance, halved.
    ridge : ndarray, shape (n, s)
        Height of the line that fits.
    """
    from scipy.special import erf

    apart = (profiles.at - shifts[:, None]) / (np.sqrt(2) * edge)
    end = factor / 2 / (np.sqrt(2) * edge)
    lines = (erf(apart + end) - erf(apart - end)) / 2
    number = np.maximum(profiles.inside.sum(axis=1, keepdims=True), 1)
    mean = profiles.inside @ lines.T / number
    power = np.maximum(profiles.inside @ (lines**2).T - number * mean**2, 1e-6)
    product = np.maximum(profiles.light @ lines.T - profiles.light.sum(axis=1, keepdims=True) * mean, 0.0)
    return product**2 / (2 * power * (profiles.scale * noise)[:, None] ** 2), product / power
