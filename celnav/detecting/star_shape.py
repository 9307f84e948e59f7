"""The shape of star images.

A star is modelled as a Gaussian of any width, length and direction: a point spread function, or the streak that a star leaves
while the camera moves. Over the frame, its covariance is a polynomial of second order in the position. This is exact for the
streaks of an affine camera motion: the covariance of a streak (du, dv) is its outer product over twelve.

Widths are measured by adaptive moments (Bernstein & Jarvis 2002, AJ 123, 583).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_VARIANCE, LARGEST_VARIANCE = 0.25, 620.0  # px^2: half a pixel, and streaks of 70 px
# A star image is round if its axes differ by less than this factor.
_ROUND = 1.2
# One round filter is good enough for shapes whose variances differ by no more than this factor.
_ONE_FILTER = 2.6
# px^2: the track of a particle is narrower than the image of a star.
_TRACK_VARIANCE = 0.2
# Variance of a Gaussian of 0.8 px with which stars are convolved before they are measured: for sharper stars, sums over
# pixels do not equal the moments.
_SMOOTHED = 0.64
_SMOOTHING = np.exp(-0.5 * np.arange(-4, 5) ** 2 / _SMOOTHED)
_SMOOTHING /= _SMOOTHING.sum()
# Shapes agree if they differ by less than this fraction of their variance; at least this many, and this fraction of all, must
# agree.
_AGREEMENT, _LEAST_AGREEING, _LEAST_SHARE = 0.2, 4, 0.15
# Of fewer stars than this, more than half must agree.
_FEW = 8
# The fit of a varying shape starts from stars within the first value times the tolerance. It must reduce the scatter to the
# second value if one filter still serves the frame, and to the third otherwise.
_LOOSE, _MILD, _STRONG = 3.0, 0.8, 0.5
# Least number of stars for a mildly varying shape: six stars for each of the six coefficients.
_FEWEST_OF_MILD = 36
# Standard deviation of the mean-shift weights, as a fraction of the size; number of steps.
_RANGE, _STEPS = 0.15, 20


@dataclass(frozen=True, eq=False)
class StarShape:
    """Covariance of the star image as a function of position.

    Attributes
    ----------
    coefficients : ndarray, shape (6, 3)
        Coefficients of 1, x, y, x^2, x y, y^2 (rows) for the covariances uu, uv, vv (columns), px^2; x and y run from -1
        to 1.
    size : tuple of int
        Height and width of the image.
    """

    coefficients: F8
    size: tuple[int, int]

    @classmethod
    def constant(cls, uu: float, uv: float, vv: float, size: tuple[int, int]) -> StarShape:
        """Make a shape that is the same everywhere."""
        coefficients = np.zeros((6, 3))
        coefficients[0] = uu, uv, vv
        return cls(coefficients, size)

    @property
    def varies(self) -> bool:
        """Whether the shape depends on the position."""
        return bool(self.coefficients[1:].any())

    @property
    def round_sigma_px(self) -> float | None:
        """The standard deviation if the shape is round and the same everywhere, else None."""
        uu, uv, vv = self.coefficients[0]
        if self.varies:
            return None
        large, small = axes(np.array([[uu, uv, vv]]))
        return float((large[0] * small[0]) ** 0.25) if large[0] < _ROUND**2 * small[0] else None

    @cached_property
    def filter_sigma_px(self) -> float | None:
        """Standard deviation of one round filter that is good enough for the whole frame; None if there is no such filter.

        A filter that is wider or narrower than the star by a factor a loses 1 - 2 a / (1 + a^2) of the signal: within the
        limit, at most 3 %.
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
        """Return the covariances (uu, uv, vv), shape (n, 3), at positions, shape (n, 2), limited to plausible widths."""
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
    """Return the large and the small eigenvalues of covariances (uu, uv, vv), shape (n, 3)."""
    uu, uv, vv = covariance.T
    root = np.hypot((uu - vv) / 2, uv)
    return (uu + vv) / 2 + root, (uu + vv) / 2 - root


def _terms(uv: F8, size: tuple[int, int]) -> F8:
    half = (np.array([size[1], size[0]]) - 1) / 2
    x, y = ((uv - half) / half).T
    return np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y))


def inverse(covariance: F8) -> F8:
    """Return the inverses (uu, uv, vv), shape (n, 3), of covariances; NaN for covariances of zero width."""
    uu, uv, vv = covariance.T
    determinant = uu * vv - uv * uv
    return np.asarray(np.stack((vv, -uv, uu), axis=1) / np.where(determinant > 1e-9, determinant, np.nan)[:, None])


def windows(light: F4, uv: F8, reach: tuple[int, int]) -> tuple[F4, NDArray[np.intp], NDArray[np.intp]]:
    """Cut windows of 2 reach + 1 pixels (rows, columns) around positions, shape (n, 2); zero beyond the border.

    Returns
    -------
    tuple of three ndarrays
        Light, shape (rows, columns, n), and the rows, shape (rows, n), and columns, shape (columns, n), of the pixels.
    """
    height, width = light.shape
    rows = np.rint(uv[:, 1]).astype(np.intp) + np.arange(-reach[0], reach[0] + 1)[:, None]
    columns = np.rint(uv[:, 0]).astype(np.intp) + np.arange(-reach[1], reach[1] + 1)[:, None]
    at = np.clip(rows, 0, height - 1)[:, None] * width + np.clip(columns, 0, width - 1)[None]
    cut = light.ravel().take(at)
    inside_rows, inside_columns = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
    if not (inside_rows.all() and inside_columns.all()):
        cut *= inside_rows[:, None] & inside_columns[None]
    return cut, rows, columns


def offsets(rows: NDArray[np.intp], columns: NDArray[np.intp], uv: F8) -> tuple[F4, F4]:
    """Return the offsets of columns and rows, shapes (columns, n) and (rows, n), from positions, shape (n, 2)."""
    return (columns - uv[:, 0]).astype(np.float32), (rows - uv[:, 1]).astype(np.float32)


def adaptive_moments(
    light: F4, uv: F8, start: F8, largest: float = LARGEST_VARIANCE, rounds: int = 8, level: F8 | None = None
) -> F8:
    """Measure covariances (uu, uv, vv), shape (n, 3), of stars at positions, shape (n, 2); NaN where there is no star.

    A source with a variance above `largest` is not a star, because gradients of light fill any window. `level`, shape (n,),
    is subtracted from the light around each position.

    The window is iterated until its covariance agrees with that of the light under it; it is then the covariance of the star.
    """
    from scipy import ndimage

    reach = int(np.clip(np.ceil(2.5 * np.sqrt(start[:, [0, 2]].max(initial=1.0))), 4, 45))
    cut, rows, columns = windows(light, uv, (reach, reach))
    if level is not None:
        cut -= level.astype(np.float32)
    smoothing = ndimage.correlate1d(np.eye(2 * reach + 1, dtype=np.float32), _SMOOTHING, axis=0, mode="nearest")
    cut = np.matmul(smoothing, np.tensordot(smoothing, cut, axes=1))
    at, covariance = uv.copy(), start + np.array([_SMOOTHED, 0, _SMOOTHED])
    for _ in range(rounds):
        window = inverse(covariance)
        total, step, seen = _windowed_moments(cut, *offsets(rows, columns, at), window)
        total = np.where(total > 0, total, np.nan)
        step /= total
        u, v = step
        seen /= total
        seen -= (u * u, u * v, v * v)
        np.minimum(np.maximum(step, -1, out=step), 1, out=step)
        at += 2 * step.T
        # For the product of light and window, the inverse covariances add.
        difference = inverse(seen.T) - window
        p, q, r = difference.T
        difference[~((p > 0) & (p * r > q**2))] = np.nan
        covariance = inverse(difference)
        large, small = axes(covariance)
        covariance[~((small > _SMOOTHED + 0.05) & (large < largest))] = np.nan
    return covariance - np.array([_SMOOTHED, 0, _SMOOTHED])


def _windowed_moments(cut: F4, du: F4, dv: F4, window: F8) -> tuple[F8, F8, F8]:
    """Sum light under Gaussian windows, and its first and second moments; shapes (n,), (2, n) and (3, n).

    Parameters
    ----------
    cut : ndarray, shape (rows, columns, n)
        Light.
    du, dv : ndarray, shapes (columns, n) and (rows, n)
        Offsets of the pixels from the centres of the windows.
    window : ndarray, shape (n, 3)
        Inverse covariances of the windows.
    """
    light = gaussians(window, du, dv)
    light *= cut
    across, down = light.sum(axis=0), light.sum(axis=1)
    mixed = np.einsum("rcn,cn->rn", light, du)
    first = ((across * du).sum(axis=0), (down * dv).sum(axis=0))
    second = ((across * du * du).sum(axis=0), (mixed * dv).sum(axis=0), (down * dv * dv).sum(axis=0))
    total, steps, moments = (np.array(each, dtype=np.float64) for each in (down.sum(axis=0), first, second))
    return total, steps, moments


def gaussians(window: F8, du: F4, dv: F4) -> F4:
    """Return Gaussians of unit peak, shape (rows, columns, n), with inverse covariances, shape (n, 3), at offsets."""
    p, q, r = window.T.astype(np.float32)
    across, down = np.float32(-0.5) * p * du * du, np.float32(-0.5) * r * dv * dv
    if np.abs(q).max(initial=0) <= 1e-3 * min(p.min(initial=1), r.min(initial=1)):
        return np.asarray(np.exp(down)[:, None] * np.exp(across)[None])
    # For an inclined Gaussian, the separate factors would exceed single precision.
    exponent = (-q * dv)[:, None] * du[None]
    exponent += across[None]
    exponent += down[:, None]
    return np.asarray(np.exp(exponent, out=exponent))


def fit_shape(covariance: F8, uv: F8, size: tuple[int, int], least_share: float | None = None) -> StarShape | None:
    """Fit the shape to the covariances of single stars, shape (n, 3); None if too few are known or agree.

    The shape varies over the frame only if that clearly reduces the scatter. `least_share` of all sources must agree; by
    default 0.15 of those whose covariance is known.
    """
    least = 0.0 if least_share is None else least_share * len(covariance)
    known = np.isfinite(covariance).all(axis=1)
    if (stars := known & ~(axes(covariance)[1] < _TRACK_VARIANCE)).sum() >= _FEW:
        known = stars
    covariance, uv = covariance[known], uv[known]
    if len(uv) < _LEAST_AGREEING:
        return None
    agreeing = _largest_agreement(covariance)
    if len(uv) < _FEW and not _few_alike(covariance, agreeing):
        return None
    middle = _middle(covariance, np.median(covariance[agreeing], axis=0))
    fixed = StarShape.constant(*_at_least(middle), size) if _enough(agreeing, least) else None
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
    if best is None or not _enough(alike, least):
        return fixed
    mild = best.filter_sigma_px is not None
    if mild and len(uv) < _FEWEST_OF_MILD:
        return fixed
    both = alike | agreeing
    # Allow for the scatter that six coefficients absorb by chance.
    free = max(int(alike.sum()) - terms.shape[1], 1)
    rest: F8 = np.abs(covariance - middle).sum(axis=1)[both] * np.sqrt(free / alike.sum())
    residual: F8 = np.abs(covariance - terms @ best.coefficients).sum(axis=1)[both]
    least = _MILD if mild else _STRONG
    return best if median(residual) < least * median(rest) else fixed


def _middle(covariance: F8, start: F8) -> F8:
    """Find a local mean of covariances, shape (n, 3), starting from `start`; shape (3,).

    Widths that vary over the frame have no sharp mode. Weights that fall smoothly with the difference in size and form keep
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
        if total < 1.0:  # less than one star is near: streaks of many directions, whose median is none of them
            return start
        middle = np.asarray(weight @ covariance / total)
    return middle


def _robust_fit(terms: F8, covariance: F8, begun: Mask) -> F8:
    """Fit the polynomial to the covariances, shape (n, 3), that agree with it, starting from those in `begun`."""
    kept = begun
    coefficients = np.zeros((6, 3))
    for _ in range(6):
        some = terms[kept]
        square, right = some.T @ some, some.T @ covariance[kept]
        coefficients = np.asarray(np.linalg.lstsq(square, right, rcond=None)[0], dtype=np.float64)
        residual: F8 = np.abs(covariance - terms @ coefficients).sum(axis=1)
        before, kept = kept, residual <= 3.5 * median(residual[begun])
        if (kept == before).all():
            break
    return coefficients


def _tolerance(covariance: F8) -> F8:
    """Return the difference up to which covariances agree, shape (n,); it includes the Gaussian they were convolved with."""
    return np.asarray(_AGREEMENT * (covariance[:, 0] + covariance[:, 2] + _SMOOTHED))


def _near(covariance: F8, middle: F8, factor: float) -> Mask:
    return np.asarray(np.abs(covariance - middle).sum(axis=1) < factor * _tolerance(covariance))


def _largest_agreement(covariance: F8) -> Mask:
    """Return which covariances agree with the one that most others agree with: stars are alike, particle tracks are not."""
    from scipy.spatial.distance import cdist

    apart = cdist(covariance, covariance, "cityblock")
    near = apart < _tolerance(covariance)[:, None]
    return np.asarray(near[np.argmax(near.sum(axis=1))])


def _few_alike(covariance: F8, agreeing: Mask) -> bool:
    """Return whether more than half agree and none of these is the track of a particle."""
    enough = 2 * agreeing.sum() > len(agreeing) and agreeing.sum() >= _LEAST_AGREEING
    return bool(enough and (axes(covariance[agreeing])[1] >= _TRACK_VARIANCE).all())


def _enough(agreeing: Mask, least: float) -> bool:
    return bool(agreeing.sum() >= max(_LEAST_AGREEING, _LEAST_SHARE * len(agreeing), least))


def median(values: F8) -> float:
    """Return the median of a few numbers; NumPy's takes many times as long."""
    middle = len(values) // 2
    ordered = np.partition(values, (middle - 1, middle))
    return float(ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2)


def _at_least(covariance: F8) -> tuple[float, float, float]:
    uu, uv, vv = (float(value) for value in covariance)
    return max(uu, LEAST_VARIANCE), uv, max(vv, LEAST_VARIANCE)
