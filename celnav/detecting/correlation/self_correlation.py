"""Autocorrelation of an image, in which the common shape of its stars adds up, however faint each of them is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.detecting.noise_map import NoiseMap

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

SHIFTS = 96
"""Largest shift in pixels, along rows and columns, to both sides."""
# Light is clipped at this many standard deviations, so that no bright star decides; of large images, only the middle is used.
_MOST_LIGHT, _MIDDLE_PX = 5.0, 1024
# Glare is a mean light above this in a square of this many pixels; a bright streak 5 px wide has at most 1.1 there.
_GLARE, _GLARE_PX = 1.5, 32


def correlations_of_halves(light: F4, noise: NoiseMap, without_glare: bool = False) -> tuple[F8, F8] | None:
    """Correlate the halves of an image with themselves, in units of the noise's variance.

    Parameters
    ----------
    light : ndarray, shape (height, width)
        Image minus background, zero where it is not used.
    noise : NoiseMap
        Standard deviation of its pixels.
    without_glare : bool
        Leave out areas where many pixels together are above the background, as around the Moon.

    Returns
    -------
    tuple of two ndarrays, shape (2 SHIFTS + 1, 2 SHIFTS + 1), or None
        Correlations for shifts along rows (first axis) and columns; None if the image is too small, or has no glare to leave
        out.
    """
    height, width = light.shape
    top, left = max(0, (height - _MIDDLE_PX) // 2), max(0, (width - _MIDDLE_PX) // 2)
    bottom, right = min(height, top + _MIDDLE_PX), min(width, left + _MIDDLE_PX)
    if min(bottom - top, right - left) <= SHIFTS or max(bottom - top, right - left) <= 2 * SHIFTS:
        return None
    part = light[top:bottom, left:right] / noise.strip(top, bottom)[:, left:right]
    part = np.clip(part, -_MOST_LIGHT, _MOST_LIGHT)
    if without_glare:
        glare = _glare(part)
        if not glare.any():
            return None
        part[glare] = 0.0
    one, other = np.array_split(part, 2, axis=1 if width > height else 0)
    return _correlation(one), _correlation(other)


def _glare(light: F4) -> NDArray[np.bool_]:
    """Return the pixels in and next to blocks whose mean light, in standard deviations, exceeds that of stars or streaks."""
    high, wide = (-(-side // _GLARE_PX) for side in light.shape)
    padded = np.zeros((high * _GLARE_PX, wide * _GLARE_PX), dtype=light.dtype)
    padded[: light.shape[0], : light.shape[1]] = light
    blocks = np.abs(padded.reshape(high, _GLARE_PX, wide, _GLARE_PX).mean(axis=(1, 3))) > _GLARE
    if not blocks.any():
        return np.zeros(light.shape, dtype=bool)
    around = np.pad(blocks, 1)
    beside = np.any([around[i : i + high, j : j + wide] for i in range(3) for j in range(3)], axis=0)
    return np.asarray(np.kron(beside, np.ones((_GLARE_PX, _GLARE_PX), dtype=bool))[: light.shape[0], : light.shape[1]])


def _correlation(light: F4) -> F8:
    """Return the autocorrelation of an image for shifts from -SHIFTS to SHIFTS along rows (first axis) and columns."""
    from scipy import fft

    light = light - light.mean()
    rows, columns = (fft.next_fast_len(side + SHIFTS, real=True) for side in light.shape)
    reach = np.arange(-SHIFTS, SHIFTS + 1)
    # One direction after the other: empty rows are not transformed, nor are shifts that nobody asks for.
    spectrum = fft.fft(fft.rfft(light, columns, axis=1), rows, axis=0, overwrite_x=True)
    power = spectrum.real**2 + spectrum.imag**2
    whole = fft.irfft(fft.ifft(power, axis=0)[reach], columns, axis=1)[:, reach] / light.size
    return np.asarray(whole, dtype=np.float64)
