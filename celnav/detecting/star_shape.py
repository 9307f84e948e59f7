"""The shape of a star's image, and the filter matched to it.

A star is a Gaussian of any width, length and direction: a point spread function, or the streak that a star leaves while
the camera moves. Over the frame its covariance is a polynomial of second order in the position, which is exact for the
streaks of a camera that moves affinely: the covariance of a streak (du, dv) is its outer product over twelve.

Widths are measured by adaptive moments (Bernstein & Jarvis 2002, AJ 123, 583).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_VARIANCE, LARGEST_VARIANCE = 0.25, 400.0  # px^2: half a pixel, and streaks of 70 px
# A star's image is round where its axes differ by less than this factor.
_ROUND = 1.2
# One round filter serves shapes whose variances differ by no more than this factor.
_ONE_FILTER = 2.6
_ZONE_PX = 180
_STRIP_PX = 32
# px^2: the track of a particle is narrower than the image of a star.
_TRACK_VARIANCE = 0.2
# A Gaussian of 0.8 px that is laid over stars before they are measured, and its variance: sums over pixels are not the
# moments of a star that is sharper.
_SMOOTHED = 0.64
_SMOOTHING = np.exp(-0.5 * np.arange(-4, 5) ** 2 / _SMOOTHED)
_SMOOTHING /= _SMOOTHING.sum()
# Shapes that differ by less than this part of their variance agree; so many must, and this part of all.
_AGREEMENT, _LEAST_AGREEING, _LEAST_SHARE = 0.2, 4, 0.15
# A shape that varies starts from those within so many times the agreement, and has to leave so much less scatter: a part
# where one filter serves it all the same, or half.
_LOOSE, _MILD, _STRONG = 3.0, 0.8, 0.5
# Standard deviation of the weights of a mean shift, as a part of the size; its steps.
_RANGE, _STEPS = 0.15, 20


@dataclass(frozen=True, eq=False)
class StarShape:
    """Covariance of a star's image as a function of its place.

    Attributes
    ----------
    coefficients : ndarray, shape (6, 3)
        Of 1, x, y, x^2, x y, y^2 (rows) for the covariances uu, uv, vv (columns), px^2; x and y run from -1 to 1.
    size : tuple of int
        Height and width of the image.
    """

    coefficients: F8
    size: tuple[int, int]

    @classmethod
    def constant(cls, uu: float, uv: float, vv: float, size: tuple[int, int]) -> StarShape:
        """Return a shape that is the same everywhere."""
        coefficients = np.zeros((6, 3))
        coefficients[0] = uu, uv, vv
        return cls(coefficients, size)

    @property
    def varies(self) -> bool:
        """Whether it depends on the place."""
        return bool(self.coefficients[1:].any())

    @property
    def round_sigma_px(self) -> float | None:
        """The standard deviation where the shape is the same everywhere and round; None elsewhere."""
        uu, uv, vv = self.coefficients[0]
        if self.varies:
            return None
        large, small = axes(np.array([[uu, uv, vv]]))
        return float((large[0] * small[0]) ** 0.25) if large[0] < _ROUND**2 * small[0] else None

    @property
    def filter_sigma_px(self) -> float | None:
        """Standard deviation of one round filter that serves the whole frame; None where none does.

        A filter that is wider or narrower than the star by a factor a loses 1 - 2 a / (1 + a^2) of the signal: within the
        limit 3 % at most.
        """
        if not self.varies:
            variances = axes(self.coefficients[:1])
        else:
            v, u = np.mgrid[0:5, 0:5] / 4
            places = np.column_stack((u.ravel() * (self.size[1] - 1), v.ravel() * (self.size[0] - 1)))
            variances = axes(self.at(places))
        large, small = float(variances[0].max()), float(variances[1].min())
        return float((large * small) ** 0.25) if 0 < large < _ONE_FILTER * small else None

    def at(self, uv: F8) -> F8:
        """Return the covariances (uu, uv, vv), shape (n, 3), at positions, shape (n, 2); kept within sensible widths."""
        covariance = _terms(uv, self.size) @ self.coefficients
        if not self.varies:
            return np.asarray(covariance)
        large, small = axes(covariance)
        mean = (large + small) / 2
        clipped_large = np.clip(large, LEAST_VARIANCE, LARGEST_VARIANCE)
        clipped_small = np.clip(small, LEAST_VARIANCE, LARGEST_VARIANCE)
        stretch = (clipped_large - clipped_small) / np.maximum(large - small, 1e-9)
        centre = (clipped_large + clipped_small) / 2
        half = (covariance[:, 0] - mean) * stretch
        return np.column_stack((centre + half, covariance[:, 1] * stretch, centre - half))


def axes(covariance: F8) -> tuple[F8, F8]:
    """Eigenvalues, large and small, of covariances (uu, uv, vv), shape (n, 3)."""
    uu, uv, vv = covariance.T
    root = np.hypot((uu - vv) / 2, uv)
    return (uu + vv) / 2 + root, (uu + vv) / 2 - root


def _terms(uv: F8, size: tuple[int, int]) -> F8:
    half = (np.array([size[1], size[0]]) - 1) / 2
    x, y = ((uv - half) / half).T
    return np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y))


def inverse(covariance: F8) -> F8:
    """Return the inverses (uu, uv, vv), shape (n, 3), of covariances; NaN for covariances without width."""
    uu, uv, vv = covariance.T
    determinant = uu * vv - uv * uv
    return np.asarray(np.column_stack((vv, -uv, uu)) / np.where(determinant > 1e-9, determinant, np.nan)[:, None])


def patches(light: F4, uv: F8, reach: tuple[int, int]) -> tuple[F8, NDArray[np.int64], NDArray[np.int64]]:
    """Cut windows of 2 reach + 1 pixels (rows, columns) around positions; zero beyond the border.

    Returns
    -------
    Light, shape (n, rows, columns), and the rows, shape (n, rows), and columns, shape (n, columns), of the pixels.
    """
    height, width = light.shape
    rows = np.rint(uv[:, 1]).astype(np.int64)[:, None] + np.arange(-reach[0], reach[0] + 1)
    columns = np.rint(uv[:, 0]).astype(np.int64)[:, None] + np.arange(-reach[1], reach[1] + 1)
    cut = light[np.clip(rows, 0, height - 1)[:, :, None], np.clip(columns, 0, width - 1)[:, None, :]].astype(np.float64)
    cut *= ((rows >= 0) & (rows < height))[:, :, None]
    cut *= ((columns >= 0) & (columns < width))[:, None, :]
    return cut, rows, columns


def adaptive_moments(
    light: F4, uv: F8, start: F8, largest: float = LARGEST_VARIANCE, rounds: int = 8, level: F8 | None = None
) -> F8:
    """Measure covariances (uu, uv, vv), shape (n, 3), of stars at positions, shape (n, 2); NaN where there is no star.

    What is wider than the variance `largest` is no star: slopes of light fill any window. `level`, shape (n,), is taken off
    the light around each.

    The window has the covariance of the star: it is what the light under the window and the window itself agree on.
    """
    from scipy import ndimage

    reach = int(np.clip(np.ceil(2.5 * np.sqrt(start[:, [0, 2]].max(initial=1.0))), 4, 30))
    cut, rows, columns = patches(light, uv, (reach, reach))
    if level is not None:
        cut -= level[:, None, None]
    cut = ndimage.correlate1d(
        ndimage.correlate1d(cut, _SMOOTHING, axis=1, mode="nearest"), _SMOOTHING, axis=2, mode="nearest"
    )
    at, covariance = uv.copy(), start + np.array([_SMOOTHED, 0, _SMOOTHED])
    for _ in range(rounds):
        du, dv = (columns - at[:, :1])[:, None, :], (rows - at[:, 1:])[:, :, None]
        p, q, r = (value[:, None, None] for value in inverse(covariance).T)
        window = cut * np.exp(-0.5 * (p * du * du + 2 * q * du * dv + r * dv * dv))
        total = window.sum(axis=(1, 2))
        total = np.where(total > 0, total, np.nan)
        step = np.column_stack((np.sum(window * du, axis=(1, 2)), np.sum(window * dv, axis=(1, 2)))) / total[:, None]
        du, dv = du - step[:, :1, None], dv - step[:, 1:, None]
        seen = np.column_stack([np.sum(window * x, axis=(1, 2)) for x in (du * du, du * dv, dv * dv)]) / total[:, None]
        at += 2 * np.clip(step, -1, 1)
        # Light and window multiply: their inverse covariances add.
        difference = inverse(seen) - inverse(covariance)
        good = (difference[:, 0] > 0) & (difference[:, 0] * difference[:, 2] > difference[:, 1] ** 2)
        covariance = np.where(good[:, None], inverse(np.where(good[:, None], difference, [[1.0, 0.0, 1.0]])), np.nan)
        large, small = axes(covariance)
        covariance[~((small > _SMOOTHED + 0.05) & (large < largest))] = np.nan
    return covariance - np.array([_SMOOTHED, 0, _SMOOTHED])


def unlikeness(cut: F8, star: F8, noise_power: F8) -> tuple[F8, F8]:
    """How much of the light in windows is not that of a star.

    Parameters
    ----------
    cut : ndarray, shape (n, rows, columns)
        Light; beyond 2.5 standard deviations of the star it does not count.
    star : ndarray, shape (n, rows, columns)
        The star's image, with a peak of 1.
    noise_power : ndarray, shape (n, rows, columns)
        Variance of the light without stars.

    Returns
    -------
    unlike : ndarray, shape (n,)
        Root of the power that the star that fits best leaves over beyond noise, over the root of the star's own: 0 for a
        star, 0.5 and more for the track of a particle, infinity where the star has no light.
    significance : ndarray, shape (n,)
        That power in standard deviations of the noise's.
    """
    inner = star > np.exp(-0.5 * 2.5**2)
    star = star * inner
    own: F8 = np.sum(star * star, axis=(1, 2))
    peak = np.maximum(np.sum(cut * star, axis=(1, 2)) / np.maximum(own, 1e-30), 0.0)
    left: F8 = np.sum(np.square((cut - peak[:, None, None] * star) * inner), axis=(1, 2))
    by_noise: F8 = np.sum(noise_power * inner, axis=(1, 2))
    spread = np.sqrt(2 * np.sum(np.square(noise_power * inner), axis=(1, 2)))
    excess = np.maximum(left - by_noise, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.where(peak > 0, excess / (peak**2 * own), np.inf))), np.asarray(
            excess / np.maximum(spread, 1e-30)
        )


def fit_shape(covariance: F8, uv: F8, size: tuple[int, int]) -> StarShape | None:
    """Fit the shape to the covariances of single stars, shape (n, 3); None where too few are known, or agree.

    It varies over the frame only where that leaves clearly less scatter.
    """
    known = np.isfinite(covariance).all(axis=1)
    if (stars := known & ~(axes(covariance)[1] < _TRACK_VARIANCE)).sum() >= 8:
        known = stars
    covariance, uv = covariance[known], uv[known]
    if len(uv) < 8:
        return None
    agreeing = _largest_agreement(covariance)
    middle = _middle(covariance, np.median(covariance[agreeing], axis=0))
    fixed = StarShape.constant(*_at_least(middle), size) if _enough(agreeing) else None
    if len(uv) < 20:
        return fixed
    terms = _terms(uv, size)
    tolerance = _tolerance(covariance)
    best, alike = None, agreeing
    for begun in (np.ones(len(uv), dtype=bool), _near(covariance, middle, _LOOSE)):
        if begun.sum() < 20:
            continue
        coefficients = _robust_fit(terms, covariance, begun)
        near = np.abs(covariance - terms @ coefficients).sum(axis=1) < tolerance
        if best is None or near.sum() > alike.sum():
            best, alike = StarShape(coefficients, size), near
    if best is None or not _enough(alike):
        return fixed
    both = alike | agreeing
    rest: F8 = np.abs(covariance - middle).sum(axis=1)[both]
    residual: F8 = np.abs(covariance - terms @ best.coefficients).sum(axis=1)[both]
    least = _MILD if best.filter_sigma_px is not None else _STRONG
    return best if np.median(residual) < least * np.median(rest) else fixed


def _middle(covariance: F8, start: F8) -> F8:
    """Find the mean of covariances, shape (n, 3), that are near it, from `start` on; shape (3,).

    Widths that change over the frame have no sharp mode. Weights that fall smoothly with the difference of size and form keep
    the mean from jumping as single stars come and go (mean shift, Comaniciu & Meer 2002, IEEE Trans. PAMI 24, 603).
    """
    middle = start
    size = covariance[:, 0] + covariance[:, 2] + _SMOOTHED
    for _ in range(_STEPS):
        own = middle[0] + middle[2] + _SMOOTHED
        form = covariance - middle
        skew = np.hypot(form[:, 0] - form[:, 2], 2 * form[:, 1]) / np.sqrt(size * own)
        weight = np.exp(-0.5 * (np.log(size / own) ** 2 + skew**2) / _RANGE**2)
        total = float(weight.sum())
        if total < 1.0:  # less than one star is near: streaks of many directions, of which the median is none
            return start
        middle = np.asarray(weight @ covariance / total)
    return middle


def _robust_fit(terms: F8, covariance: F8, begun: Mask) -> F8:
    """Fit the polynomial to the covariances, shape (n, 3), that agree with it, from those of `begun` on."""
    kept = begun
    coefficients = np.zeros((6, 3))
    for _ in range(6):
        coefficients = np.asarray(np.linalg.lstsq(terms[kept], covariance[kept], rcond=None)[0], dtype=np.float64)
        residual: F8 = np.abs(covariance - terms @ coefficients).sum(axis=1)
        kept = residual <= 3.5 * np.median(residual[begun])
    return coefficients


def _tolerance(covariance: F8) -> F8:
    """Difference up to which covariances agree, shape (n,): they were measured under the Gaussian laid over them."""
    return np.asarray(_AGREEMENT * (covariance[:, 0] + covariance[:, 2] + _SMOOTHED))


def _near(covariance: F8, middle: F8, factor: float) -> Mask:
    return np.asarray(np.abs(covariance - middle).sum(axis=1) < factor * _tolerance(covariance))


def _largest_agreement(covariance: F8) -> Mask:
    """Tell which covariances agree with the one that most agree with: stars are alike, particles' tracks are not."""
    apart = np.abs(covariance[:, None] - covariance).sum(axis=2)
    near = apart < _tolerance(covariance)[:, None]
    return np.asarray(near[np.argmax(near.sum(axis=1))])


def _enough(agreeing: Mask) -> bool:
    return bool(agreeing.sum() >= max(_LEAST_AGREEING, _LEAST_SHARE * len(agreeing)))


def _at_least(covariance: F8) -> tuple[float, float, float]:
    uu, uv, vv = (float(value) for value in covariance)
    return max(uu, LEAST_VARIANCE), uv, max(vv, LEAST_VARIANCE)


@dataclass(frozen=True, eq=False)
class Filtered:
    """An image under the matched filter.

    Attributes
    ----------
    amplitude : ndarray, shape (height, width)
        Peak of the star that fits best at each pixel.
    noise_factor : ndarray, shape (height, width) or (1, 1)
        Its standard deviation over that of a pixel.
    """

    amplitude: F4
    noise_factor: F4


def matched_filter(light: F4, shape: StarShape) -> Filtered:
    """Correlate with the star's image less its mean over a square: constant and sloping backgrounds cancel."""
    from scipy import ndimage

    sigma = shape.filter_sigma_px
    if sigma is None:
        return _filter_by_zones(light, shape)
    reach = max(2, int(np.ceil(3 * sigma)))
    offsets = np.arange(-reach, reach + 1)
    line = np.exp(-0.5 * (offsets / sigma) ** 2)
    side = 2 * int(np.ceil(7 * sigma)) + 1
    gain, noise = _response(np.outer(line, line), side**2)
    scaled = (line / line.sum()).astype(np.float32)
    summed = _correlated(light, scaled)
    summed -= ndimage.uniform_filter(light, side, mode="nearest")
    summed *= np.float32(1 / gain)
    return Filtered(summed, np.full((1, 1), noise / gain, dtype=np.float32))


def _correlated(values: F4, line: F4) -> F4:
    """Correlate along both axes with a symmetrical line, strip by strip, so that a strip stays in the processor's cache."""
    reach = len(line) // 2
    height, width = values.shape
    result = np.empty_like(values)
    down = np.empty((_STRIP_PX, width + 2 * reach), dtype=np.float32)
    pair = np.empty((_STRIP_PX, width), dtype=np.float32)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    for top in range(0, height, _STRIP_PX):
        rows = min(_STRIP_PX, height - top)
        strip, part = down[:rows], pair[:rows]
        middle = strip[:, reach : reach + width]
        np.multiply(padded[top + reach : top + reach + rows], line[reach], out=middle)
        for k in range(1, reach + 1):
            above, below = top + reach - k, top + reach + k
            np.add(padded[above : above + rows], padded[below : below + rows], out=part)
            part *= line[reach + k]
            middle += part
        strip[:, :reach] = middle[:, :1]
        strip[:, reach + width :] = middle[:, -1:]
        out = result[top : top + rows]
        np.multiply(middle, line[reach], out=out)
        for k in range(1, reach + 1):
            np.add(strip[:, reach - k : reach - k + width], strip[:, reach + k : reach + k + width], out=part)
            part *= line[reach + k]
            out += part
    return result


def _response(star: F8, area: int) -> tuple[float, float]:
    """Response of the filter to a star of unit peak, and to unit noise."""
    kernel = star / star.sum()
    gain = float((kernel * star).sum() - star.sum() / area)
    return gain, float(np.sqrt((kernel**2).sum() - 1 / area))


def _filter_by_zones(light: F4, shape: StarShape) -> Filtered:
    """Apply the filter of each zone of the frame; one zone where the shape is the same everywhere."""
    from scipy import ndimage, signal

    height, width = light.shape
    rows, columns = (max(1, round(n / _ZONE_PX)) if shape.varies else 1 for n in (height, width))
    row_edges, column_edges = (np.linspace(0, n, k + 1).astype(int) for n, k in ((height, rows), (width, columns)))
    amplitude, factor = np.empty_like(light), np.empty_like(light)
    for top, bottom in pairwise(row_edges):
        for left, right in pairwise(column_edges):
            covariance = shape.at(np.array([[(left + right - 1) / 2, (top + bottom - 1) / 2]]))
            p, q, r = inverse(covariance)[0]
            reach_u, reach_v = (int(np.ceil(3 * np.sqrt(covariance[0, k]))) for k in (0, 2))
            dv, du = np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1]
            star = np.exp(-0.5 * (p * du * du + 2 * q * du * dv + r * dv * dv))
            side = 2 * int(np.ceil(2.4 * max(reach_u, reach_v))) + 1
            gain, noise = _response(star, side**2)
            margin = side // 2
            above, before = min(margin, top), min(margin, left)
            window = light[top - above : bottom + margin, left - before : right + margin]
            padded = np.pad(window, ((reach_v, reach_v), (reach_u, reach_u)), mode="edge")
            kernel = (star / star.sum()).astype(np.float32)  # symmetrical: convolution is correlation
            summed = signal.oaconvolve(padded, kernel, mode="valid") - ndimage.uniform_filter(
                window, side, mode="nearest"
            )
            part = slice(above, above + bottom - top), slice(before, before + right - left)
            amplitude[top:bottom, left:right] = summed[part] / gain
            factor[top:bottom, left:right] = noise / gain
    return Filtered(amplitude, factor)
