"""Midpoints of streaks, determined from their ends.

A streak is a line convolved with a Gaussian, as in the trail fitting of Veres et al. (2012, PASP 124, 1197). Along it the
light is constant except at the ends, and only these determine its position. With a pixel noise n and a ridge of height a, the
midpoint is known to n / a, whatever the length (the Cramér-Rao bound of a line convolved with a Gaussian). The centroid under
a Gaussian of the streak's length leaves out the ends, and scatters three times as much.

The profile of a streak is compared with lines at all shifts, and the likelihood-weighted mean of the shifts is its midpoint.
Its uncertainty grows as the streak gets fainter, up to the whole range if noise hides the ends. Direction and length are
those of the star shape, corrected by the streaks themselves in each part of the frame (`celnav.detecting.streaks.lean`): read
along a line that is inclined by some degrees, the ends of a long streak are lost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.correlation.streak import GAUSSIAN_OF_LINE
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.star_centroids import CENTROID_FLOOR_PX, Measured
from celnav.detecting.star_shape import axes
from celnav.detecting.streaks.lean import FINDING, PLACING, lean, smooth

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# Least ratio of the variances along the axes of a streak (below, the ends are as wide as it is long), and least number of
# streaks.
_LONG, _FEWEST = 9.0, 4
# Range of profiles beyond the shape's ends, and of shifts from the found position: a fraction of the length, and pixels.
_BEYOND, _BEYOND_PX = 0.35, 2.0
# Half-lengths that are tried, in steps of a fraction of the shape's length; 40 steps are half of that length itself.
_HALF_STEP, _HALVES, _UNCHANGED = 0.0125, np.arange(28, 59), 40
_LENGTHS = 2 * _HALF_STEP * _HALVES
# Step of profiles, and largest step of shifts, px.
_STEP_PX, _SHIFT_PX = 0.5, 0.2
# Largest weight of a single streak in the fit of the length: half its squared significance. Number of streaks used for it.
_MOST, _TELLING = 200.0, 256
_LENGTH_FLOOR = 0.02
# Fractions of the lengths from which directions, and positions across streaks, are determined.
_LEANING, _PLACING = (0.35, 0.7), 0.85
# Number of streaks measured at a time.
_AT_ONCE = 256


class Streaks(NamedTuple):
    """Streaks of stars.

    Attributes
    ----------
    ends : ndarray, shape (n, 2)
        Vector from one end to the other, px, in either sense; 0 for a star without a streak.
    sigma_across : ndarray, shape (n,)
        Standard deviation of a star's position across its streak, px.
    """

    ends: F8
    sigma_across: F8


class _Profiles(NamedTuple):
    """Light along streaks, in units of their lengths.

    Attributes
    ----------
    at : ndarray, shape (t,)
        Positions along the streaks, over their lengths.
    light : ndarray, shape (n, t)
        Sum across the streak, weighted by its Gaussian width.
    inside : ndarray, shape (n, t)
        1 inside the image, 0 outside.
    scale : ndarray, shape (n,)
        Noise of a profile value over that of a pixel, allowing for the number of pixels per step.
    """

    at: F8
    light: F8
    inside: F8
    scale: F8


@dataclass(frozen=True, eq=False)
class _Ends:
    """A table of soft ends, from which lines of all lengths at all shifts follow as differences.

    Positions are in units of the lengths.

    Attributes
    ----------
    step : float
        Step of shifts, which divides all half-lengths.
    steps : int
        Number of steps in a `_HALF_STEP`.
    at : ndarray, shape (t,)
        Positions along profiles.
    shifts : ndarray, shape (s,)
        Shifts of the midpoint.
    beyond : ndarray, shape (t, e)
        Light at the positions of a line that starts at an end and continues; the ends are at multiples of `step`.
    """

    step: float
    steps: int
    at: F8
    shifts: F8
    beyond: F8

    @classmethod
    def of(cls, length_px: float, edge: float) -> _Ends:
        """Make the table for streaks of a length whose ends are soft with a standard deviation of `edge` lengths."""
        from scipy.special import ndtr

        steps = int(np.ceil(_HALF_STEP * length_px / _SHIFT_PX))
        step = _HALF_STEP / steps
        half = 0.5 * _LENGTHS[-1] + _BEYOND + 2 * _BEYOND_PX / length_px
        at = np.arange(-half, half, _STEP_PX / length_px)
        most = int((_BEYOND + _BEYOND_PX / length_px) / step)
        far = most + steps * int(_HALVES[-1])
        beyond = np.asarray(ndtr((at[:, None] - step * np.arange(-far, far + 1)) / edge), dtype=np.float64)
        shifts = step * np.arange(-most, most + 1.0)
        return cls(step, steps, at, shifts, beyond)

    def lines(self, table: F8, half: int) -> F8:
        """Return lines from a table by ends, shape (m, e), for half-lengths in `_HALF_STEP`s; by shifts, shape (m, s)."""
        first, number = self.steps * (int(_HALVES[-1]) - half), len(self.shifts)
        last = first + 2 * self.steps * half
        return np.asarray(table[:, first : first + number] - table[:, last : last + number])


def by_ends(
    light: F4, noise: NoiseMap, stars: Measured, covariance: F8, gain_e_per_unit: float
) -> tuple[Measured, Streaks | None]:
    """Measure positions and lengths of streaks from their ends; other stars, and all if streaks are few, stay unchanged.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    noise : NoiseMap
        Standard deviation of its pixels without stars.
    stars : Measured
        Centroids under the stars' own windows.
    covariance : ndarray, shape (n, 3)
        Covariances of the star images: uu, uv, vv, px^2.
    gain_e_per_unit : float
        Electrons per unit of the image.

    Returns
    -------
    Measured, Streaks or None
        The stars, and their streaks; None if there are few streaks.
    """
    large, small = axes(covariance)
    long = np.flatnonzero(large > _LONG * small)
    if len(long) < _FEWEST:
        return stars, None
    large, small, (uu, uv, vv) = large[long], small[long], covariance[long].T
    turn = np.arctan2(2 * uv, uu - vv) / 2
    along = np.column_stack((np.cos(turn), np.sin(turn)))
    length, width = np.sqrt(GAUSSIAN_OF_LINE * (large - small)), np.sqrt(small)
    found = stars.uv[long]
    rows, columns = np.rint(found[:, ::-1]).astype(np.intp).T
    size = light.shape
    pixel = noise.at(rows.clip(0, size[0] - 1), columns.clip(0, size[1] - 1)).astype(np.float64)
    extent = size[0], size[1]
    for inner in _LEANING:
        _, slope, uncertain = lean(light, found, along, length, width, pixel, inner, FINDING)
        along = _turned(along, smooth(found, extent, slope, uncertain, found))
    ends = _Ends.of(float(np.median(length)), float(np.median(width / length)))
    telling = np.linspace(0, len(long) - 1, min(len(long), _TELLING)).astype(np.intp)
    profiles = _profiles(light, found[telling], along[telling], length[telling], width[telling], ends.at)
    factor, own, uncertain = _lengths(_likelihoods(profiles, ends, pixel[telling]))
    length = length * factor * (1 + smooth(found[telling], extent, own / factor - 1, uncertain / factor, found))
    lines, placed = ends.lines(ends.beyond, _UNCHANGED), []
    for start in range(0, len(long), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        profiles = _profiles(light, found[part], along[part], length[part], width[part], ends.at)
        placed.append(_placed(*_fit(profiles, lines, profiles.light @ lines, pixel[part]), ends.shifts))
    shift, spread, ridge, significance = np.concatenate(placed, axis=1)
    spread *= length
    # Across a streak, all of its light determines the position: the error is its width over the signal-to-noise ratio from
    # sky noise, and over the root of its own electrons.
    electrons = np.sqrt(2 * np.pi) * width * ridge * length * gain_e_per_unit
    across = np.hypot(width * np.sqrt(1 / np.maximum(significance, 1) ** 2 + 1 / electrons), CENTROID_FLOOR_PX)
    # At the ends, photon noise of half of the ridge's light contributes too.
    spread = np.sqrt(spread**2 + 1 / (2 * ridge * gain_e_per_unit) + (ends.step * length) ** 2 / 12)
    moved = found + (shift * length)[:, None] * along
    offset, _, _ = lean(light, moved, along, length, width, pixel, _PLACING, PLACING)
    moved[:, 0] -= offset * along[:, 1]
    moved[:, 1] += offset * along[:, 0]
    inside = ((moved >= 0) & (moved <= np.array([size[1], size[0]]) - 1)).all(axis=1)
    at, sigma = stars.uv.copy(), stars.sigma_px.copy()
    at[long[inside]] = moved[inside]
    along_px = np.maximum(np.hypot(spread[inside], CENTROID_FLOOR_PX), across[inside])
    sigma[long[inside]] = np.hypot(along_px, across[inside]) / np.sqrt(2)
    streak, beside = np.zeros_like(at), sigma.copy()
    streak[long] = length[:, None] * along
    beside[long[inside]] = across[inside]
    return replace(stars, uv=at, sigma_px=sigma), Streaks(streak, beside)


def _lengths(best: F8) -> tuple[float, F8, F8]:
    """Return the factor on the lengths common to all streaks, that of each streak, and their standard deviations.

    `best` holds likelihoods for the `_LENGTHS`, shape (lengths, n). No single bright streak decides.
    """
    counted = np.minimum(1, _MOST / np.maximum(best.max(axis=0), 1e-30))
    each = np.exp(best - best.max(axis=0))
    each /= each.sum(axis=0)
    own = _LENGTHS @ each
    spread = np.sqrt(np.maximum(_LENGTHS**2 @ each - own**2, 0) + _LENGTH_FLOOR**2)
    return float(_LENGTHS[np.argmax(best @ counted)]), own, spread


def _turned(along: F8, slope: F8) -> F8:
    """Rotate directions, shape (n, 2), by slopes relative to them, shape (n,)."""
    turned = along + slope[:, None] * np.column_stack((-along[:, 1], along[:, 0]))
    return np.asarray(turned / np.hypot(*turned.T)[:, None])


def _placed(likelihood: F8, ridge: F8, shifts: F8) -> F8:
    """Return each streak's likelihood-weighted mean shift, its scatter, and ridge and significance at the peak; (4, n)."""
    weight = np.exp(likelihood - likelihood.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    shift = weight @ shifts
    spread = np.sqrt(np.maximum(weight @ shifts**2 - shift**2, 0))
    ridge = np.maximum(np.take_along_axis(ridge, likelihood.argmax(axis=1)[:, None], axis=1)[:, 0], 1e-30)
    return np.stack((shift, spread, ridge, np.sqrt(2 * likelihood.max(axis=1))))


def _profiles(light: F4, uv: F8, along: F8, length: F8, width: F8, at: F8) -> _Profiles:
    """Read the light along streaks at positions `at`, shape (t,), in units of their lengths."""
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


def _likelihoods(profiles: _Profiles, ends: _Ends, noise: F8) -> F8:
    """Return for each of the `_LENGTHS` the largest log-likelihood over all shifts of each profile, shape (lengths, n)."""
    table = profiles.light @ ends.beyond
    fits = (_fit(profiles, ends.lines(ends.beyond, half), ends.lines(table, half), noise) for half in _HALVES.tolist())
    return np.array([likelihood.max(axis=1) for likelihood, _ in fits])


def _fit(profiles: _Profiles, lines: F8, product: F8, noise: F8) -> tuple[F8, F8]:
    """Fit a line and a level to each profile at all shifts.

    Parameters
    ----------
    profiles : _Profiles
    lines : ndarray, shape (t, s)
        Lines of one length at all shifts.
    product : ndarray, shape (n, s)
        The profiles' light times the lines, summed along them.
    noise : ndarray, shape (n,)
        Standard deviation of a pixel.

    Returns
    -------
    likelihood : ndarray, shape (n, s)
        Log-likelihood up to a constant: half the square of the line's significance.
    ridge : ndarray, shape (n, s)
        Height of the fitted line.
    """
    # All profiles that are wholly inside the image have the same sums of the lines.
    cut = np.flatnonzero(~profiles.inside.all(axis=1))
    inside = np.concatenate((np.ones((1, len(lines))), profiles.inside[cut]))
    own = np.zeros(len(product), dtype=np.intp)
    own[cut] = np.arange(1, len(inside))
    number = np.maximum(inside.sum(axis=1, keepdims=True), 1)
    mean = inside @ lines / number
    power = np.maximum(inside @ lines**2 - number * mean**2, 1e-6)
    product = np.maximum(product - profiles.light.sum(axis=1, keepdims=True) * mean[own], 0.0)
    ridge = product / power[own]
    return product * ridge / (2 * (profiles.scale * noise)[:, None] ** 2), ridge
