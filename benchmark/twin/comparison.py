"""Comparison of a photograph and its twin: detections, sky, noise and stars, measured by the same code on the same sky."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, uniform_filter
from scipy.spatial import cKDTree

from benchmark.photographed.star_light import isolated, star_light
from benchmark.photographed.star_width import star_widths
from benchmark.photographed.view import View, on_mask
from celnav.detection import detect

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

DETECTED_ABOVE_DEG = 20.0
SKY_EDGES_DEG = (10, 15, 20, 30, 40, 55, 90)
STAR_PX = 1.5
"""Distance from a catalogued star within which a detection is that star."""
STAR_MAG = 7.5
"""Faintest star that a detection can be."""
NAMED_MAG = 4.5
"""Faintest star of the medians over stars."""
MEASURED_MAG = 6.0
"""Faintest star whose light is measured, for bins of magnitude."""
WIDTH_ABOVE_DEG = 10.0
"""Altitude above which the width of stars is measured: lower than their light, so that more of the lens is seen."""
SEP_SIGMA = 3.0
NOISE_ABOVE_DEG = 35.0
GLARE = 1.5
"""Light over the median sky above which the noise of a pixel is ignored: around the Moon the lens causes the variation."""
PATCH_PX = 32
LEAST_CLEAN = 0.6
"""Fraction of a patch that must be free of detections for its spectrum."""
BANDS_PER_PX = (0.03, 0.1, 0.2, 0.35, 0.5)
"""Edges of the bands of the noise's power spectrum, cycles per pixel."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements on one image.

    Attributes
    ----------
    celnav, sep : int
        Detections above 20 deg.
    celnav_spurious, sep_spurious : float
        Fraction of them further than 1.5 px from any catalogued star to V 7.5.
    sky : (6,) array
        Median light of the sky above the dark level by altitude (`SKY_EDGES_DEG`), DN; NaN without sky.
    noise : float
        Standard deviation of a pixel above 35 deg, DN.
    autocorrelation : (2,) array
        Autocorrelation of neighbours along u and v.
    spectrum : (4,) array
        Mean power in `BANDS_PER_PX` over the variance.
    stars : Stars
        The n stars to which the next arrays belong.
    snr : (n,) array
        SNR of the stars brighter than V 6 without a neighbour, above 20 deg; NaN of others and of saturated ones.
    nearest_share : (n,) array
        Fraction of their light in the brightest pixel.
    flux : (n,) array
        Flux of these stars, DN.
    width_px : (n,) array
        Standard deviation (`star_widths`) of such stars above 10 deg; NaN of others.
    width_snr : (n,) array
        SNR of these stars.
    """

    celnav: int
    celnav_spurious: float
    sep: int
    sep_spurious: float
    sky: Floats
    noise: float
    autocorrelation: Floats
    spectrum: Floats
    stars: Stars
    snr: Floats
    nearest_share: Floats
    flux: Floats
    width_px: Floats
    width_snr: Floats


@dataclass(frozen=True, eq=False)
class Stars:
    """Catalogued stars of a frame.

    Attributes
    ----------
    uv : (n, 2) array
        Expected positions, px.
    v_mag, altitude_deg : (n,) arrays
    off_axis_deg : (n,) array
        Angle from the optical axis.
    """

    uv: Floats
    v_mag: Floats
    altitude_deg: Floats
    off_axis_deg: Floats


def measure(
    pixels: NDArray[np.floating], dark: NDArray[np.floating], view: View, sky: Mask, stars: Stars, highest_dn: float
) -> Measured:
    """Measure an image in DN; `sky` is the mask of sky pixels, `highest_dn` the value from which pixels are saturated."""
    usable = sky & np.nan_to_num(view.altitude_deg >= DETECTED_ABOVE_DEG)
    faint = stars.uv[stars.v_mag < STAR_MAG]
    tree = cKDTree(faint[np.isfinite(faint).all(axis=1)])
    found = detect(np.rint(pixels).astype(np.uint16), mask=~sky).uv
    ours = found[on_mask(found, usable)]
    theirs = _sep(pixels, sky)
    theirs = theirs[on_mask(theirs, usable)]
    upper = usable & (view.altitude_deg >= NOISE_ABOVE_DEG)
    smooth = uniform_filter(pixels - dark, PATCH_PX)
    noise, autocorrelation, spectrum = _noise(pixels, upper & (smooth < GLARE * np.median((pixels - dark)[upper])))
    alone = isolated(stars.uv, stars.v_mag)
    alone &= (stars.v_mag < MEASURED_MAG) & (stars.altitude_deg > WIDTH_ABOVE_DEG) & on_mask(stars.uv, sky)
    light = star_light(pixels, np.where(alone[:, None], stars.uv, np.nan), search_px=2.0)
    whole = light.peak < 0.8 * highest_dn
    lit = whole & (stars.altitude_deg > DETECTED_ABOVE_DEG) & on_mask(stars.uv, usable)
    levels = np.full(len(SKY_EDGES_DEG) - 1, np.nan)
    for band, (low, high) in enumerate(itertools.pairwise(SKY_EDGES_DEG)):
        part = sky & (view.altitude_deg >= low) & (view.altitude_deg < high)
        if part.any():
            levels[band] = np.median((pixels - dark)[part])
    return Measured(
        celnav=len(ours),
        celnav_spurious=_spurious(ours, tree),
        sep=len(theirs),
        sep_spurious=_spurious(theirs, tree),
        sky=levels,
        noise=noise,
        autocorrelation=autocorrelation,
        spectrum=spectrum,
        stars=stars,
        snr=np.where(lit, light.snr, np.nan),
        nearest_share=np.where(lit, light.nearest_share, np.nan),
        flux=np.where(lit, light.flux, np.nan),
        width_px=np.where(whole, star_widths(pixels, light), np.nan),
        width_snr=np.where(whole, light.snr, np.nan),
    )


def _spurious(uv: Floats, stars: cKDTree) -> float:
    if not len(uv):
        return float("nan")
    distance, _ = stars.query(uv)
    return float(np.mean(distance > STAR_PX))


def _sep(pixels: NDArray[np.floating], sky: Mask) -> Floats:
    """Positions (n, 2) of what sep detects at 3 sigma of its own noise estimate."""
    import sep  # from the extra `peers`

    image = np.ascontiguousarray(pixels, dtype=np.float32)
    background = sep.Background(image, mask=~sky, bw=32, bh=32)
    sep.set_extract_pixstack(2_000_000)
    sep.set_sub_object_limit(10_000)
    found = sep.extract(image - background.back(), SEP_SIGMA, err=background.rms(), mask=~sky)
    return np.column_stack((found["x"], found["y"])).astype(np.float64)


def _noise(pixels: NDArray[np.floating], usable: Mask) -> tuple[float, Floats, Floats]:
    """Standard deviation, autocorrelation of neighbours along u and v, and normalised power by band, of star-free sky."""
    import sep

    image = np.ascontiguousarray(pixels, dtype=np.float32)
    background = sep.Background(image, mask=~usable, bw=PATCH_PX, bh=PATCH_PX)
    rest = image - background.back()
    outlying = binary_dilation(usable & (rest > 3 * background.rms()), iterations=3)
    clean = usable & ~outlying
    values = np.where(clean, rest, np.nan)
    sums, patches = np.zeros((PATCH_PX, PATCH_PX)), 0
    lags: list[Floats] = []
    deviations: list[float] = []
    for v in range(0, image.shape[0] - PATCH_PX + 1, PATCH_PX):
        for u in range(0, image.shape[1] - PATCH_PX + 1, PATCH_PX):
            patch = values[v : v + PATCH_PX, u : u + PATCH_PX].astype(np.float64)
            part = np.isfinite(patch).mean()
            if part < LEAST_CLEAN:
                continue
            patch = patch - np.nanmean(patch)
            variance = float(np.nanmean(patch**2))
            if variance <= 0:
                continue
            lags.append(np.array([_product(patch[:, 1:], patch[:, :-1]), _product(patch[1:], patch[:-1])]) / variance)
            deviations.append(np.sqrt(variance))
            sums += np.abs(np.fft.fft2(np.nan_to_num(patch))) ** 2 / (variance * part * PATCH_PX**2)
            patches += 1
    if not patches:
        return float("nan"), np.full(2, np.nan), np.full(len(BANDS_PER_PX) - 1, np.nan)
    power = sums / patches
    frequency = np.hypot(np.fft.fftfreq(PATCH_PX)[:, None], np.fft.fftfreq(PATCH_PX)[None, :])
    bands = np.array([
        power[(frequency >= low) & (frequency < high)].mean()
        for low, high in itertools.pairwise(BANDS_PER_PX)
    ])  # fmt: skip
    return float(np.median(deviations)), np.median(lags, axis=0), bands


def _product(one: Floats, other: Floats) -> float:
    return float(np.nanmean(one * other))
