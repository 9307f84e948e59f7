"""Star detection: matched filter, peaks, rejection of sources unlike stars, and centroids with standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.checking import bounded, check_fields, shown
from celnav.detecting.blank_border import blank_border
from celnav.detecting.colour_mosaic import level_mosaic
from celnav.detecting.correlation.self_correlation import correlations_of_halves
from celnav.detecting.correlation.streak import streak_of_image
from celnav.detecting.correlation.width import width_of_image
from celnav.detecting.filtered_noise import noise_ratio
from celnav.detecting.flood_fill import FloodFillConfig, flood_fill
from celnav.detecting.image_background import (
    as_image,
    background_and_noise,
    grey,
    highest_of_two,
    outstanding,
    remove_line_offsets,
    repair_defects,
    step_of,
    take_off,
    typical,
    unmasked,
    used_pixels,
)
from celnav.detecting.matched_filter import Filtered, matched_filter
from celnav.detecting.noise_map import NoiseMap
from celnav.detecting.row_statistics import all_true
from celnav.detecting.shape_stars import shape_of_bright, shape_of_components
from celnav.detecting.star_candidates import (
    Components,
    Cores,
    components,
    peaks,
    saturated_cores,
    saturated_pixels,
    trails,
    without_flanks,
)
from celnav.detecting.star_centroids import Measured, measure_stars
from celnav.detecting.star_shape import StarShape, axes
from celnav.detecting.streaks.ends import by_ends
from celnav.detecting.surroundings import amid_scatter, in_texture
from celnav.detecting.tiles import Tiles, mean_map
from celnav.detections import Detections
from celnav.errors import ConfigError

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Mask = NDArray[np.bool_]

# The background is subtracted in single precision; anything below this fraction of the largest values is rounding.
_FLOAT_ROUNDING = 4e-6
# An image whose noise is at most this fraction of its highest peak has none.
_NOISE_FREE = 1e-6
_FIRST_SIGMA_PX = 1.0
# Noise of fewer electrons than this is rare. An image without its sky or with a pedestal too small to be light has less.
_FEWEST_NOISE_E = 3.0
# A filter is good enough for stars whose width is within these factors of its own; it loses at most 6 % of their signal.
_SERVES = (0.7, 1.35)
_SHAPE_ROUNDS = 2
# The noise map is estimated with clipping and known to some per cent only. Raising the threshold by this factor keeps the
# rate of false detections at that of the nominal threshold.
_NOISE_MARGIN = 1.04
# The noise of the filtered image is correlated over the width of a star. Tiles of this many standard deviations of the star
# image hold enough independent values.
_TILE_OVER_SIGMA = 24
# A star exceeds the scatter of its surroundings by this fraction of the threshold.
_OVER_SURROUNDINGS = 0.88
# Stars whose shape is measured exceed it this many times.
_FAR_OUT = 8.0
# So much of what stands out so far must have one shape: particle tracks stand out, too.
_ALIKE_FAR_OUT = 0.2
# A compact source is rejected if its light that does not have a star's form, relative to the star's light, reaches the first
# value at a significance of the second.
_UNLIKE, _UNLIKE_SIGNIFICANCE = 0.5, 4.0
_COMPACT_VARIANCE, _WIDER_THAN_GUESSED = 4.0, 1.1
# Peaks that are measured for each faint detection wanted: some are unlike stars.
_TRIED_FAINT = 3
FAINT_STARS = 60
"""Enough for an identification with a known attitude where no star stands out; for `DetectionConfig.faint_stars`."""


@dataclass(frozen=True)
class DetectionConfig:
    """Configuration of the detection.

    Attributes
    ----------
    seed_sigma : float
        Threshold: a star is a peak of the filtered image this many standard deviations above zero. At 4.5, white noise
        causes about three false detections per million pixels.
    grow_sigma : float
        Threshold for connected components, in standard deviations; the components serve to recognise trails.
    psf_sigma_px : float or None
        Standard deviation of the point spread function; None measures it and its variation over the frame.
    streak_px : tuple of float or None
        Displacement (du, dv) of stars during the exposure, if the motion of the camera is known; None measures it.
    gain_e_per_dn : float or None
        Electrons per unit of the image, for the photon noise of stars; None assumes that the noise of the sky is the
        photon noise of its light.
    saturation_dn : float or None
        Value from which pixels are saturated; None derives it from groups of four or more pixels that share the highest
        value within 3 %.
    max_area_px : int
        Largest saturated area that can be a star; larger ones are the Moon or lamps.
    trail_length_px : float or None
        A narrow component that exceeds the length of stars by this much and is bright over its whole length is rejected
        as the trail of a satellite or an aeroplane; None keeps all.
    tile_px : int
        Side of the tiles whose medians give background and noise.
    float_floor : float
        For floating-point images without noise: least threshold, as a fraction of the highest peak. Integer images have
        a floor of one step.
    faint_stars : int
        Where fewer stars than this reach `seed_sigma`, the brightest sources above `grow_sigma` follow them until there
        are so many. Most of these are noise; `celnav.solve` uses them only where it refuses the others. 0: none.
    """

    seed_sigma: float = 4.5
    grow_sigma: float = 3.0
    psf_sigma_px: float | None = bounded(None, 0.3, 10)
    streak_px: tuple[float, float] | None = None
    gain_e_per_dn: float | None = None
    saturation_dn: float | None = None
    max_area_px: int = bounded(1000, 1)
    trail_length_px: float | None = 20.0
    tile_px: int = bounded(32, 4)
    float_floor: float = bounded(1e-4, 0, 1)
    faint_stars: int = bounded(0, 0, 1000)

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0 < self.grow_sigma <= self.seed_sigma:
            raise ConfigError("detection needs 0 < grow_sigma <= seed_sigma")
        if self.streak_px is not None and not float(np.hypot(*self.streak_px)) <= 60:
            raise ConfigError("detection needs a streak_px of at most 60 pixels, or None")
        if self.gain_e_per_dn is not None and not self.gain_e_per_dn > 0:
            raise ConfigError("detection needs gain_e_per_dn > 0, or None")


_USUAL = DetectionConfig()


def detect(
    image: ArrayLike, mask: ArrayLike | None = None, config: DetectionConfig | FloodFillConfig | None = None
) -> Detections:
    """Find stars in an image.

    Parameters
    ----------
    image : array_like, shape (height, width) or (height, width, 3 or 4)
        Brightness. Colours are averaged with Rec. 601 weights, and a fourth channel (opacity) is ignored, as are masked
        entries of a `numpy.ma.MaskedArray`.
    mask : array_like of bool, shape (height, width), optional
        True where the image is **not** to be used (an overlay, a horizon, dead pixels).
    config : DetectionConfig or FloodFillConfig, optional
        Configuration; with a `FloodFillConfig`, stars are detected as in the thesis.

    Returns
    -------
    Detections
        Detected stars, brightest first.

    Raises
    ------
    ImageError
        For a wrong shape, NaN, or a mask that does not fit the image.
    ConfigError
        For a configuration of another type.
    """
    config = _USUAL if config is None else config
    image, mask = unmasked(image, mask)
    if isinstance(config, FloodFillConfig):
        return Detections(*flood_fill(image, mask, config))
    if not isinstance(config, DetectionConfig):
        raise ConfigError(f"config = {shown(config)} must be a celnav.DetectionConfig or a FloodFillConfig")
    original = as_image(image)
    filtered = _filter(original, mask, config)
    if filtered is None:
        return Detections(np.empty((0, 2)), np.empty(0), original.shape[:2], np.empty(0))
    stars = _measure(filtered, filtered.found.peaks, config.seed_sigma, config)
    if len(stars) >= config.faint_stars:
        return stars
    fainter = filtered.found.peaks_above(config.grow_sigma, len(stars) + _TRIED_FAINT * config.faint_stars)
    return stars.followed_by(_measure(filtered, fainter, config.grow_sigma, config), config.faint_stars)


@dataclass(frozen=True, eq=False)
class _FilteredSky:
    """An image without its background, the noise of its pixels, the shape of its stars, and what a search for them found.

    `guessed` tells that nothing is known of the shape; `gain_e_per_unit` is in electrons per unit of the image.
    """

    light: F4
    noise: NoiseMap
    cores: Cores
    shape: StarShape
    guessed: bool
    gain_e_per_unit: float
    found: _Found


def _filter(original: NDArray[np.generic], mask: ArrayLike | None, config: DetectionConfig) -> _FilteredSky | None:
    """Prepare an image and filter it for stars of the shape that they have in it; None if nothing is bright."""
    pixels = grey(original)
    used = used_pixels(pixels, mask)
    if not (all_true(used) or used.any()):
        return None
    tiles = Tiles.of((pixels.shape[0], pixels.shape[1]), config.tile_px)
    if (blank := blank_border(pixels, tiles)) is not None:
        used = used & ~blank
    counts, step = pixels, step_of(pixels)
    if original.ndim == 2:
        pixels = level_mosaic(pixels, used, config.tile_px, 1.01 * step)
    levels, whites = zip(*(background_and_noise(pixels, used, grid, step) for grid in tiles.both), strict=True)
    background, white = mean_map(levels), mean_map(whites)
    whole = all_true(used)
    saturated = saturated_pixels(counts if whole else np.where(used, counts, background.whole()), config.saturation_dn)
    of_whole_numbers = np.issubdtype(original.dtype, np.integer)
    light = pixels
    highest = take_off(light, background, used)
    if highest <= 0:
        return None
    floor = max(step, 1.0)
    if not of_whole_numbers:
        peak = max(highest_of_two(light), 0.0) or highest
        floor = _FLOAT_ROUNDING * (abs(typical(background, used)) + peak)
        if typical(white, used) <= _NOISE_FREE * peak:
            floor = max(floor, config.float_floor * peak)
    noise = NoiseMap(white, floor / config.seed_sigma)
    cores = saturated_cores(saturated, light)
    usual_noise = typical(noise, used)
    level = remove_line_offsets(light, usual_noise, used)
    if level is not light:
        # Neighbours in different lines also differed by the lines' offsets, so the noise is estimated again.
        white = mean_map([background_and_noise(level, used, grid)[1] for grid in tiles.both])
        light, noise = level, replace(noise, white=white)
        usual_noise = typical(noise, used)
    far = repair_defects(light, outstanding(light, noise))

    shape = first_guess = _given_shape(config, pixels.shape)
    known = config.psf_sigma_px is not None or config.streak_px is not None
    if not known and (seen := shape_of_bright(light, far, cores)) is not None:
        shape, known = seen, True
    elif not known and (halves := correlations_of_halves(light, noise)) is not None:
        size = light.shape[0], light.shape[1]
        seen = streak_of_image(halves, size)
        if seen is None and (beside := correlations_of_halves(light, noise, without_glare=True)) is not None:
            seen = streak_of_image(beside, size)
        seen = seen or width_of_image(halves, size)
        shape = shape if seen is None else seen
    found = _search(light, noise, used, shape, config)
    if not known:
        # Streaks fall apart under a filter for point sources, so the shape is measured again on the stars found with it.
        for _ in range(_SHAPE_ROUNDS):
            measured = _shape_of_found(light, found, shape, cores, config)
            if measured is None:
                break
            filtered_by, shape = shape.filter_sigma_px, measured
            sigma = shape.filter_sigma_px
            if sigma is not None and filtered_by is not None and _SERVES[0] < sigma / filtered_by < _SERVES[1]:
                break
            alike = sigma is not None and filtered_by is not None and 0.5 < sigma / filtered_by < 2
            found = _search(light, noise, used, shape, config, found.parts if alike else None)
            if alike:
                break
    gain = config.gain_e_per_dn
    if gain is None:
        gain = max(typical(background, used), _FEWEST_NOISE_E * usual_noise) / usual_noise**2
    return _FilteredSky(light, noise, cores, shape, not known and shape is first_guess, gain, found)


def _shape_of_found(
    light: F4, found: _Found, filtered_for: StarShape, cores: Cores, config: DetectionConfig
) -> StarShape | None:
    """Measure the shape on components whose peaks stand out far, or on all if these do not agree on one."""
    peaks = found.peaks
    least = peaks.amplitude / _FAR_OUT
    out = ~amid_scatter(found.filtered.amplitude, peaks.uv, least, _extent_px(filtered_for))
    parts = found.parts
    given = peaks.part, cores, config.max_area_px
    far = shape_of_components(light, found.noise, parts.only(peaks.part[out]), *given, _ALIKE_FAR_OUT)
    return far or shape_of_components(light, found.noise, parts, *given)


def _measure(sky: _FilteredSky, peaks: _Peaks, seed_sigma: float, config: DetectionConfig) -> Detections:
    """Measure the peaks above a threshold, and reject those unlike stars."""
    found, light, shape, gain = sky.found, sky.light, sky.shape, sky.gain_e_per_unit
    kept = np.ones(len(peaks.uv), dtype=bool)
    if config.trail_length_px is not None:
        of_trail = trails(found.parts, found.filtered.amplitude, shape, sky.cores, config.trail_length_px)
        kept = ~np.isin(peaks.part, of_trail)
    least = peaks.amplitude / (_OVER_SURROUNDINGS * seed_sigma)
    kept &= ~in_texture(found.filtered.amplitude, light, sky.noise, peaks.uv, least, _extent_px(shape))
    uv, amplitude, sigma_amplitude = peaks.uv[kept], peaks.amplitude[kept], peaks.sigma_amplitude[kept]
    uv = uv[without_flanks(uv, amplitude, sigma_amplitude, seed_sigma, shape, sky.cores)]
    covariance = shape.at(uv)
    stars = measure_stars(light, found.noise, uv, covariance, gain, sky.noise)
    like_stars = _like_stars(stars, covariance, sky.guessed)
    stars, streaks = by_ends(light, found.noise, stars, covariance, gain)
    cored = _saturated_stars(light, sky.cores, shape, config)
    uv, flux, sigma_px = (
        np.concatenate((core, star[like_stars]))
        for core, star in zip(cored, (stars.uv, stars.flux, stars.sigma_px), strict=True)
    )
    order = np.argsort(-flux, kind="stable")
    ends = across = None
    if streaks is not None:
        ends = np.concatenate((np.zeros((len(cored[0]), 2)), streaks.ends[like_stars]))[order]
        across = np.concatenate((cored[2], streaks.sigma_across[like_stars]))[order]
    return Detections(uv[order], flux[order], light.shape, sigma_px[order], ends, across)


def _given_shape(config: DetectionConfig, size: tuple[int, ...]) -> StarShape:
    """Return the star shape given by the configuration, or an initial guess."""
    variance = (_FIRST_SIGMA_PX if config.psf_sigma_px is None else config.psf_sigma_px) ** 2
    du, dv = (0.0, 0.0) if config.streak_px is None else config.streak_px
    return StarShape.constant(variance + du * du / 12, du * dv / 12, variance + dv * dv / 12, (size[0], size[1]))


class _Peaks(NamedTuple):
    """Peaks of the filtered image, brightest first: positions, amplitudes with their noise, and the component of each."""

    uv: F8
    amplitude: F8
    sigma_amplitude: F8
    part: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Found:
    """The filtered image with its components and peaks, and the white pixel noise equivalent to its own noise.

    `at` holds the flat indices of the pixels above the lower threshold, and `significance` their standard deviations.
    """

    filtered: Filtered
    noise: NoiseMap
    used: Mask
    parts: Components
    at: NDArray[np.intp]
    significance: F4
    peaks: _Peaks

    def peaks_above(self, sigma: float, most: int) -> _Peaks:
        """Return the brightest peaks above a lower threshold."""
        return _peaks(self.filtered, self.noise, self.at[self.significance > sigma], self.used, self.parts, most)


def _search(
    light: F4,
    noise: NoiseMap,
    used: Mask,
    shape: StarShape,
    config: DetectionConfig,
    parts: Components | None = None,
) -> _Found:
    """Filter the image and find significant peaks, and the components unless they are supplied."""
    filtered = matched_filter(light, shape)
    extent_px = _extent_px(shape)
    tiles = Tiles.of((light.shape[0], light.shape[1]), max(config.tile_px, round(_TILE_OVER_SIGMA * extent_px)))
    ratio = mean_map([noise_ratio(filtered, noise, used, grid) for grid in tiles.both])
    effective = replace(noise, ratio=ratio)
    at, significance = _standing_out(filtered, effective, config.grow_sigma)
    seeded = significance > config.seed_sigma
    if parts is None:
        parts = components(light, at, seeded)
    seeds = _peaks(filtered, effective, at[seeded], used, parts)
    return _Found(filtered, effective, used, parts, at, significance, seeds)


def _extent_px(shape: StarShape) -> float:
    """Return the larger standard deviation of the star image in the middle of the frame."""
    height, width = shape.size
    return float(np.sqrt(axes(shape.at((np.array([[width, height]]) - 1) / 2))[0][0]))


def _peaks(
    filtered: Filtered,
    noise: NoiseMap,
    above: NDArray[np.intp],
    used: Mask,
    parts: Components,
    most: int | None = None,
) -> _Peaks:
    uv, amplitude, sigma = (x[:most] for x in peaks(filtered, noise, above, used))
    return _Peaks(uv, amplitude, sigma, parts.holding(uv))


def _standing_out(filtered: Filtered, noise: NoiseMap, least: float) -> tuple[NDArray[np.intp], F4]:
    """Find pixels above `least` standard deviations; return their flat indices and significances, shapes (n,)."""
    zones = filtered.noise_factor if filtered.noise_factor.size > 1 else None
    times = _NOISE_MARGIN * least * (1.0 if zones is not None else float(filtered.noise_factor[0, 0]))
    at, limit = noise.exceeding(filtered.amplitude, times, zones)
    with np.errstate(divide="ignore"):
        return at, filtered.amplitude.ravel().take(at) / limit * np.float32(least)


def _like_stars(stars: Measured, covariance: F8, guessed: bool) -> Mask:
    """Select the sources whose width and form agree with those of stars within the noise.

    The form distinguishes particle tracks from compact stars; streaks and large disks are not compared in form. Where the
    star shape is only a guess, wider sources are kept, since they may be wider stars.
    """
    leeway = 5 / np.maximum(stars.snr, 1e-9)
    formed = (stars.unlike < _UNLIKE) | (stars.significance < _UNLIKE_SIGNIFICANCE)
    formed |= axes(covariance)[0] > _COMPACT_VARIANCE
    if guessed:
        formed |= stars.narrow > _WIDER_THAN_GUESSED
    return np.asarray((stars.narrow > 0.5 - leeway) & (stars.wide < 1.7 + leeway) & (stars.flux > 0) & formed)


def _saturated_stars(light: F4, cores: Cores, shape: StarShape, config: DetectionConfig) -> tuple[F8, F8, F8]:
    """Measure positions, fluxes and standard deviations of saturated stars from all their light, including the flat top."""
    small = np.pi * cores.radius_px**2 <= config.max_area_px
    uv, radius = cores.uv[small], cores.radius_px[small]
    places, fluxes, radii = [], [], []
    height, width = light.shape
    spread = np.sqrt(shape.at(uv)[:, [0, 2]].mean(axis=1)) if len(uv) else np.empty(0)
    for place, r, s in zip(uv, radius, spread, strict=True):
        reach = int(np.ceil(2 * r + 3 * s))
        column, row = (round(float(x)) for x in place)
        rows = np.arange(max(row - reach, 0), min(row + reach + 1, height))[:, None]
        columns = np.arange(max(column - reach, 0), min(column + reach + 1, width))[None, :]
        part = light[rows, columns].astype(np.float64)
        window = part * np.exp(-0.5 * ((columns - place[0]) ** 2 + (rows - place[1]) ** 2) / (r + s) ** 2)
        total = float(window.sum())
        moved = np.array([(window * (columns - place[0])).sum(), (window * (rows - place[1])).sum()])
        # Where a bright sky reaches full scale, a saturated core may not stand out from it; it is then not a star.
        if not np.abs(moved).max() < total * (r + s):
            continue
        places.append(place + moved / total)
        fluxes.append(max(float(part.sum()), cores.level * np.pi * r * r))
        radii.append(r)
    return np.array(places).reshape(-1, 2), np.array(fluxes), np.hypot(0.1, 0.1 * np.array(radii))
