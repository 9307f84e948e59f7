"""Star detection: flood fill above a brightness threshold (the thesis, section 4.iii)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.errors import ConfigError, DetectionError, ImageError

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

# The background is taken off in single precision; what is smaller than this part of the image is rounding.
_FLOAT_ROUNDING = 4e-6
# What pixels, blends and the point spread function leave in the centroid of the brightest star.
CENTROID_FLOOR_PX = 0.05


@dataclass(frozen=True, eq=False)
class Detections:
    """Detected stars, brightest first.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Centroids, pixels.
    flux : ndarray, shape (n,), or None
        Light above the background, up to a constant factor of the image's unit; None where unknown.
    shape : tuple of int or None
        Height and width of the image they come from.
    sigma_px : ndarray, shape (n,), or None
        Standard deviation of each centroid along each axis, pixels; None where unknown.
    """

    uv: F8
    flux: F8 | None
    shape: tuple[int, int] | None = None
    sigma_px: F8 | None = None

    def __len__(self) -> int:
        return len(self.uv)


@dataclass(frozen=True)
class DetectionConfig:
    """Choices of the detection.

    Attributes
    ----------
    seed_sigma : float
        A star holds a pixel this many noise standard deviations above the background.
    grow_sigma : float
        The flood fill then takes neighbouring pixels above this many.
    min_area_px, max_area_px : int
        Limits of a component's area: below are hot pixels, above are the Moon, clouds and lamps.
    tile_px : int
        Side of the tiles whose medians make the background.
    float_floor : float
        For images of floating-point numbers: least threshold as a part of the highest peak. It acts on noise-free
        images, where the noise is zero. Integer images have a floor of one step.
    weighted : bool
        Weight the centroid by brightness; otherwise the middle of the component's pixels.
    window_sigma_px : float or None
        Refine the centroid under a Gaussian window of this width, which keeps the light of neighbours and the
        threshold's ragged edge out; None leaves the component's centroid as it is.
    trail_length : float or None
        A component more than three times as long as wide is the trail of a satellite or an aeroplane where it is longer
        than this many pixels, or than this many times the median of such lengths in frames whose stars are streaks
        themselves; None keeps all.
    """

    seed_sigma: float = 5.0
    grow_sigma: float = 2.5
    min_area_px: int = 2
    max_area_px: int = 1000
    tile_px: int = 32
    float_floor: float = 1e-4
    weighted: bool = True
    window_sigma_px: float | None = 1.0
    trail_length: float | None = 8.0

    def __post_init__(self) -> None:
        if not 0 < self.grow_sigma <= self.seed_sigma:
            raise ConfigError("detection needs 0 < grow_sigma <= seed_sigma")
        if not 1 <= self.min_area_px <= self.max_area_px or self.tile_px < 4:
            raise ConfigError("detection needs 1 <= min_area_px <= max_area_px and tile_px >= 4")
        if self.window_sigma_px is not None and not 0.3 <= self.window_sigma_px <= 5:
            raise ConfigError("detection needs 0.3 <= window_sigma_px <= 5, or None")


def detect(image: ArrayLike, mask: ArrayLike | None = None, config: DetectionConfig | None = None) -> Detections:
    """Find stars in an image.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Brightness; colours are averaged with Rec. 601 weights, and a fourth channel (opacity) is left out.
    mask : array_like of bool, shape (height, width), optional
        True where the image is **not** to be used (an overlay, a horizon, dead pixels).
    config : DetectionConfig, optional
        Thresholds.

    Returns
    -------
    Detections
        Brightest first.

    Raises
    ------
    ImageError
        For a wrong shape, NaN, or a mask that does not fit.
    """
    from scipy import ndimage

    config = DetectionConfig() if config is None else config
    original = np.asarray(image)
    pixels = _grey(original)
    used = np.ones(pixels.shape, dtype=bool)
    if mask is not None:
        ignored = np.asarray(mask)
        if ignored.shape != pixels.shape or ignored.dtype != np.bool_:
            raise ImageError(f"mask must be boolean of shape {pixels.shape}, true where the image is not to be used")
        used = ~ignored
    if not used.any():
        return Detections(np.empty((0, 2)), np.empty(0), pixels.shape)

    background, noise = background_and_noise(pixels, used, config.tile_px)
    light = pixels - background
    light[~used] = 0.0
    if np.issubdtype(original.dtype, np.integer):
        floor = 1.0
    else:
        floor = max(config.float_floor * float(light.max()), _FLOAT_ROUNDING * float(np.abs(pixels).max()))
    if light.max() <= 0:
        return Detections(np.empty((0, 2)), np.empty(0), pixels.shape)
    grow = np.maximum(config.grow_sigma * noise, floor)
    # Labelling only what touches a seed: most of what stands above the lower threshold is noise.
    labels, n = ndimage.label(light > grow, structure=np.ones((3, 3)))
    if n == 0:
        return Detections(np.empty((0, 2)), np.empty(0), pixels.shape)
    rows, columns = np.nonzero(labels)
    label, values = labels[rows, columns], light[rows, columns].astype(np.float64)
    seed_level = np.maximum(config.seed_sigma * noise, floor)[rows, columns]
    area = np.bincount(label, minlength=n + 1)
    seeded = np.bincount(label, weights=values > seed_level, minlength=n + 1) > 0
    good = seeded & (area >= config.min_area_px) & (area <= config.max_area_px)
    good[0] = False
    weight = values if config.weighted else np.ones_like(values)
    total = np.bincount(label, weights=weight, minlength=n + 1)[good]
    u = np.bincount(label, weights=weight * columns, minlength=n + 1)[good] / total
    v = np.bincount(label, weights=weight * rows, minlength=n + 1)[good] / total
    flux = np.asarray(np.bincount(label, weights=values, minlength=n + 1)[good], dtype=np.float64)
    uv = np.column_stack((u, v))
    if config.trail_length is not None and len(uv):
        length = _lengths(label.astype(np.intp), rows, columns, n)[good]
        short = length <= config.trail_length * max(float(np.median(length)), 1.0)
        uv, flux = uv[short], flux[short]
    if config.window_sigma_px is None:
        order = np.argsort(-flux, kind="stable")
        return Detections(uv[order], flux[order], pixels.shape)
    uv, flux = windowed_centroids(light, uv, config.window_sigma_px)
    order = np.argsort(-flux, kind="stable")
    uv, flux = uv[order], flux[order]
    nearest = np.rint(uv).astype(np.intp)
    at = np.clip(nearest[:, 1], 0, pixels.shape[0] - 1), np.clip(nearest[:, 0], 0, pixels.shape[1] - 1)
    sigma = centroid_sigma_px(flux, noise[at].astype(np.float64), config.window_sigma_px)
    return Detections(uv, flux, pixels.shape, sigma)


def centroid_sigma_px(flux: F8, noise: F8, window_sigma_px: float) -> F8:
    """Standard deviation of windowed centroids along each axis from the noise of the background, shape (n,), pixels.

    The estimate 2 sum(w I x) / sum(w I) has the variance 4 N^2 sum(w^2 x^2) / sum(w I)^2; for a Gaussian window of
    width s the sum in the numerator is pi s^4 / 2, and sum(w I) is half the flux. Pixels and blends leave
    `CENTROID_FLOOR_PX` in any case.
    """
    background = 4 * noise * window_sigma_px**2 * np.sqrt(np.pi / 2) / np.maximum(flux, 1e-12)
    return np.asarray(np.hypot(np.minimum(background, 1.0), CENTROID_FLOOR_PX))


def _lengths(label: NDArray[np.intp], rows: NDArray[np.intp], columns: NDArray[np.intp], n: int) -> F8:
    """Length of each component along its longest axis, shape (n + 1,): four standard deviations of its pixels."""
    area = np.maximum(np.bincount(label, minlength=n + 1), 1)

    def mean(values: F8) -> F8:
        return np.asarray(np.bincount(label, weights=values, minlength=n + 1) / area)

    x, y = columns.astype(np.float64), rows.astype(np.float64)
    mean_x, mean_y = mean(x), mean(y)
    x, y = x - mean_x[label], y - mean_y[label]
    xx, yy, xy = mean(x * x), mean(y * y), mean(x * y)
    largest = (xx + yy) / 2 + np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    smallest = (xx + yy) - largest
    # A round star is as wide as it is long, however bright: only what is narrow counts as a trail.
    return np.where(largest > 9 * (smallest + 1 / 12), 4 * np.sqrt(largest), 0.0)


def windowed_centroids(light: F4, uv: F8, sigma_px: float) -> tuple[F8, F8]:
    """Refine centroids, shape (n, 2), under a Gaussian window that follows them, and measure the flux, shape (n,).

    The iteration x += 2 sum(w I (x_i - x)) / sum(w I) of the windowed positions of SExtractor (Bertin & Arnouts 1996,
    and its manual), which for a Gaussian star and a window of like width is nearly as good as a fit. Negative light
    counts: leaving it out would bias towards the window's middle. A centroid that wanders off by more than the window's
    width (light of a neighbour, no star) is left as it was.

    The flux is twice the light under the window: the whole of it for a Gaussian star of the window's width, and for
    another width a constant part. It keeps the brightness order in crowded fields, which the sum over a component that
    has run into its neighbours does not.
    """
    height, width = light.shape
    reach = int(np.ceil(3 * sigma_px))
    offsets = np.arange(-reach, reach + 1)
    columns = np.rint(uv[:, 0]).astype(np.int64)[:, None] + offsets
    rows = np.rint(uv[:, 1]).astype(np.int64)[:, None] + offsets
    inside = ((columns >= 0) & (columns < width))[:, None, :] & ((rows >= 0) & (rows < height))[:, :, None]
    patch = light[np.clip(rows, 0, height - 1)[:, :, None], np.clip(columns, 0, width - 1)[:, None, :]] * inside
    at = uv.copy()
    flux = np.zeros(len(uv))
    for _ in range(6):
        du, dv = columns - at[:, :1], rows - at[:, 1:]
        window = np.exp(-0.5 * (dv[:, :, None] ** 2 + du[:, None, :] ** 2) / sigma_px**2) * patch
        total = window.sum(axis=(1, 2))
        flux = 2 * total
        total = np.where(total > 0, total, np.inf)
        at[:, 0] += 2 * np.sum(window.sum(axis=1) * du, axis=1) / total
        at[:, 1] += 2 * np.sum(window.sum(axis=2) * dv, axis=1) / total
        np.clip(at, uv - 2 * sigma_px, uv + 2 * sigma_px, out=at)
    wandered = np.linalg.norm(at - uv, axis=1) > sigma_px
    return np.where(wandered[:, None], uv, at), np.maximum(flux, 0.0)


def background_and_noise(pixels: F4, used: NDArray[np.bool_], tile_px: int) -> tuple[F4, F4]:
    """Estimate background and noise, both of the image's shape.

    Medians of tiles, smoothed by a 3x3 median and interpolated bilinearly; the noise is 1.4826 times the median
    absolute deviation of each tile. Unused pixels do not count; a tile without pixels takes the image's median.
    """
    from scipy import ndimage

    height, width = pixels.shape
    rows, columns = max(1, round(height / tile_px)), max(1, round(width / tile_px))
    row_edges = np.linspace(0, height, rows + 1).astype(int)
    column_edges = np.linspace(0, width, columns + 1).astype(int)
    everything = float(np.median(pixels[used]))
    level = np.empty((rows, columns), dtype=np.float32)
    spread = np.empty_like(level)
    masked = not used.all()
    for i in range(rows):
        for j in range(columns):
            window = slice(row_edges[i], row_edges[i + 1]), slice(column_edges[j], column_edges[j + 1])
            values = pixels[window][used[window]] if masked else pixels[window].ravel()
            if values.size == 0:
                level[i, j], spread[i, j] = everything, np.nan
                continue
            level[i, j] = _median(values)
            spread[i, j] = 1.4826 * _median(np.abs(values - level[i, j]))
    spread[np.isnan(spread)] = np.nanmedian(spread)
    level = ndimage.median_filter(level, 3, mode="nearest")
    spread = ndimage.median_filter(spread, 3, mode="nearest")
    row_weights, column_weights = _interpolation(row_edges), _interpolation(column_edges)
    return row_weights @ level @ column_weights.T, row_weights @ spread @ column_weights.T


def _median(values: F4) -> float:
    """Upper median by partition: the mean of two middle values is not worth a second pass."""
    middle = values.size // 2
    return float(np.partition(values, middle)[middle])


def _interpolation(edges: NDArray[np.int_]) -> F4:
    """Matrix, shape (pixels, tiles), that interpolates linearly between tile centres and extrapolates at the ends."""
    pixels, tiles = int(edges[-1]), len(edges) - 1
    weights = np.zeros((pixels, tiles), dtype=np.float32)
    if tiles == 1:
        weights[:, 0] = 1
        return weights
    centres = (edges[:-1] + edges[1:] - 1) / 2
    at = np.arange(pixels)
    left = np.clip(np.searchsorted(centres, at) - 1, 0, tiles - 2)
    part = (at - centres[left]) / (centres[left + 1] - centres[left])
    weights[at, left] = 1 - part
    weights[at, left + 1] = part
    return weights


def _grey(image: NDArray[np.generic]) -> F4:
    if image.dtype == np.bool_ or not np.issubdtype(image.dtype, np.number) or np.iscomplexobj(image):
        raise ImageError(f"image must hold real numbers, not {image.dtype}")
    if image.ndim == 3 and image.shape[2] in (3, 4):
        grey = image[:, :, :3].astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
    elif image.ndim == 2:
        grey = image.astype(np.float32)
    else:
        raise ImageError(f"image has shape {image.shape}; it must be (height, width) or (height, width, 3 or 4)")
    if min(grey.shape) < 3:
        raise ImageError(f"image of {grey.shape[1]} x {grey.shape[0]} pixels is too small")
    if not np.isfinite(grey).all():
        raise ImageError("image holds NaN or infinity: replace them, or pass a mask and finite values")
    return np.asarray(grey)


def as_positions(uv: ArrayLike) -> F8:
    """Return pixel positions as an (n, 2) array of finite numbers; raises `DetectionError` otherwise."""
    try:
        positions = np.array(uv, dtype=np.float64)
    except (TypeError, ValueError):
        raise DetectionError("detections must be numbers of shape (n, 2)") from None
    if positions.size == 0:
        return np.empty((0, 2))
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise DetectionError(f"detections have shape {positions.shape}; they must be (n, 2): u and v in pixels")
    if not (finite := np.isfinite(positions).all(axis=1)).all():
        raise DetectionError(
            f"detection {int(np.flatnonzero(~finite)[0])} has a NaN or infinite position: leave out such detections"
        )
    return positions


def as_detections(detections: Detections | ArrayLike, flux: ArrayLike | None = None) -> Detections:
    """Return validated detections for whatever `celnav.solve` accepts as such."""
    shape, sigma = None, None
    if isinstance(detections, Detections):
        if flux is not None:
            raise DetectionError("give flux either in the detections or as flux=, not both")
        positions, flux, shape = as_positions(detections.uv), detections.flux, detections.shape
        if detections.sigma_px is not None:
            sigma = _column("sigma_px", detections.sigma_px, len(positions))
            if (sigma <= 0).any():
                raise DetectionError("sigma_px must be positive")
    else:
        positions = as_positions(detections)
    brightness = None if flux is None else _column("flux", flux, len(positions))
    return Detections(positions, brightness, shape, sigma)


def _column(name: str, values: ArrayLike, n: int) -> F8:
    try:
        column = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise DetectionError(f"{name} must be numbers of shape (n,)") from None
    if column.shape != (n,):
        raise DetectionError(f"{name} has shape {column.shape}; it must be ({n},), one per detection")
    if not np.isfinite(column).all():
        raise DetectionError(f"{name} holds NaN or infinity")
    return column
