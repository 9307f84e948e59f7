"""Selection of the stars from which the star shape is measured: bright, single, complete, and from all over the frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.close_pairs import close_pairs
from celnav.detecting.image_background import Outstanding
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.star_candidates import Components, Cores
from celnav.detecting.star_shape import LARGEST_VARIANCE, StarShape, adaptive_moments, axes, fit_shape, offsets, windows

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

_STARS, _COMPONENTS = 300, 120
# Within this many pixels, only this many sources count at a time.
_AROUND_PX, _EACH = 56.0, 2
# Maxima this many times above the noise of a pixel, without a brighter one within this distance.
_BRIGHT, _ALONE_PX = 20.0, 6.0
# Largest number of maxima considered, and least number for a reliable shape.
_MOST_MAXIMA, _FEWEST_MAXIMA = 5000, 12
# Radius of the ring around a star where its light has faded, and number of places on it; least ratio of a star's peak to the
# scatter of the light on the ring.
_RING_PX, _RING_PLACES, _OVER_RING = 8.0, 40, 20.0
# If more than the second fraction of sources have an elongation above the first (moments of the axes 1 : 2.3), they are
# streaks or tracks.
_LONG, _MOST_LONG, _WINDOW_PX = 0.4, 0.4, 5
# Sources with a larger variance than the first, px^2, are measured under larger windows; the second is the largest variance
# under small windows.
_WIDE_VARIANCE, _LARGEST_COMPACT = 6.0, 9.0


def shape_of_bright(light: F4, far: Outstanding, cores: Cores) -> StarShape | None:
    """Measure the shape on bright maxima of the image itself; None if they are few or disagree, as streaks do.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    far : Outstanding
        All pixels that may be bright enough.
    cores : Cores
        Saturated stars, which are left out.
    """
    width, flat = light.shape[1], light.ravel()
    bright = far.value > np.float32(_BRIGHT) * far.sigma
    at, value = far.at[bright], far.value[bright]
    for offset in (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1):
        highest = value >= flat.take(at + offset)
        at, value = at[highest], value[highest]
    if len(at) < _FEWEST_MAXIMA:
        return None
    order = np.argsort(-value, kind="stable")[:_MOST_MAXIMA]
    rows, columns = np.divmod(at[order], width)
    uv, value = np.column_stack((columns, rows)).astype(np.float64), value[order]
    alone = np.ones(len(uv), dtype=bool)
    alone[close_pairs(uv, _ALONE_PX).max(axis=1, initial=0)] = False
    if len(cores.uv):
        from scipy.spatial import cKDTree

        distance, core = cKDTree(cores.uv).query(uv)
        alone &= distance > 3 * cores.radius_px[core] + _ALONE_PX
    uv, value = uv[alone], value[alone]
    if len(uv) < _FEWEST_MAXIMA:
        return None
    # The surroundings of maxima in trees, walls and edges of clouds scatter; stars, streaks and tracks are isolated.
    level, scatter = _ring_around(light, uv)
    single = value - level > _OVER_RING * scatter
    uv, value, level = uv[single], value[single], level[single]
    if len(uv) < _FEWEST_MAXIMA:
        return None
    chosen = _brightest_around(uv, value.astype(np.float64))[:_STARS]
    if np.mean(_elongation(light, uv[chosen]) > _LONG) > _MOST_LONG:
        return None
    begun = np.tile([1.0, 0.0, 1.0], (len(chosen), 1))
    covariance = adaptive_moments(light, uv[chosen], begun, _LARGEST_COMPACT, level=level[chosen])
    return fit_shape(covariance, uv[chosen], (light.shape[0], light.shape[1]))


def _ring_around(light: F4, uv: F8) -> tuple[F8, F8]:
    """Return level and scatter of the light on rings around positions, shape (n, 2): medians and median deviations, (n,).

    The level contains the residual of clouds and glare after background subtraction, which would widen stars.
    """
    turn = np.linspace(0, 2 * np.pi, _RING_PLACES, endpoint=False)
    columns = np.rint(uv[:, :1] + _RING_PX * np.cos(turn)).astype(np.intp)
    rows = np.rint(uv[:, 1:] + _RING_PX * np.sin(turn)).astype(np.intp)
    height, width = light.shape
    ring = np.sort(light[rows.clip(0, height - 1), columns.clip(0, width - 1)].astype(np.float64), axis=1)
    level = _middle_of(ring)
    return level, 1.4826 * _middle_of(np.sort(np.abs(ring - level[:, None]), axis=1))


def _middle_of(ordered: F8) -> F8:
    """Return the medians of sorted rows, shape (n, _RING_PLACES)."""
    return np.asarray((ordered[:, (_RING_PLACES - 1) // 2] + ordered[:, _RING_PLACES // 2]) / 2)


def _elongation(light: F4, uv: F8) -> F8:
    """Return the difference of the axes' second moments over their sum, shape (n,), at positions, shape (n, 2)."""
    cut, rows, columns = windows(light, uv, (_WINDOW_PX, _WINDOW_PX))
    du, dv = offsets(rows, columns, uv)
    window = np.maximum(cut, 0)
    across, down = window.sum(axis=0), window.sum(axis=1)
    total = np.maximum(down.sum(axis=0), np.float32(1e-30))
    u, v = (across * du).sum(axis=0) / total, (down * dv).sum(axis=0) / total
    uu, vv = (across * du * du).sum(axis=0) / total - u * u, (down * dv * dv).sum(axis=0) / total - v * v
    mixed = (np.einsum("rcn,cn->rn", window, du) * dv).sum(axis=0) / total - u * v
    return np.asarray(np.hypot(uu - vv, 2 * mixed) / np.maximum(uu + vv, 1e-30), dtype=np.float64)


def shape_of_components(
    light: F4,
    noise: NoiseMap,
    parts: Components,
    part_of_peak: NDArray[np.int32],
    cores: Cores,
    max_area_px: int,
    least_share: float | None = None,
) -> StarShape | None:
    """Measure the shape on bright components that are neither saturated nor, if there are enough others, blended.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background.
    noise : NoiseMap
        Standard deviation of its pixels.
    parts : Components
        Components above the noise.
    part_of_peak : ndarray of int32, shape (n,)
        The component that contains each peak.
    cores : Cores
        Saturated stars.
    max_area_px : int
        Largest area of a component that can be a star.
    least_share : float, optional
        As for `fit_shape`.
    """
    at = np.rint(parts.uv).astype(np.intp)
    clear = parts.flux > 15 * noise.at(at[:, 1], at[:, 0]) * np.sqrt(np.maximum(parts.area, 1))
    clear &= (parts.area >= 5) & (parts.area <= max_area_px)
    if len(cores.uv):
        clear &= ~np.isin(parts.label, parts.holding(cores.uv))
    single = clear & (np.bincount(part_of_peak, minlength=int(parts.label.max(initial=0)) + 1)[parts.label] == 1)
    chosen = np.flatnonzero(single if single.sum() > max(20, 0.3 * clear.sum()) else clear)
    dense = parts.flux[chosen] / parts.area[chosen]
    chosen = chosen[_brightest_around(parts.uv[chosen], dense)[:_COMPONENTS]]
    if not len(chosen):
        return None
    # Start from the components' own moments, since streaks differ in length and direction over the frame.
    begun = np.clip(parts.covariance[chosen], [0.5, -150, 0.5], [150, 150, 150])
    determinant = begun[:, 0] * begun[:, 2] - begun[:, 1] ** 2
    begun = np.where((determinant > 0.1)[:, None], begun, [[1.0, 0.0, 1.0]])
    covariance = np.empty_like(begun)
    wide = axes(begun)[0] > _WIDE_VARIANCE
    for some, largest in ((wide, LARGEST_VARIANCE), (~wide, _LARGEST_COMPACT)):
        covariance[some] = adaptive_moments(light, parts.uv[chosen][some], begun[some], largest)
    return fit_shape(covariance, parts.uv[chosen], (light.shape[0], light.shape[1]), least_share)


def _brightest_around(uv: F8, brightness: F8) -> Rows:
    """Order sources by the number of brighter ones around them, in groups of a few, then by brightness.

    Trees, lamps and reflections are close together; stars are everywhere.
    """
    order = np.argsort(-brightness, kind="stable")
    pairs = close_pairs(uv[order], _AROUND_PX)
    brighter = np.bincount(pairs.max(axis=1, initial=0), minlength=len(uv)) if len(pairs) else np.zeros(len(uv), int)
    return np.asarray(order[np.argsort(brighter // _EACH, kind="stable")])
