"""What a camera's processor does to a picture: noise reduction and sharpening."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from generator.scenario.processing.video_spec import DenoiseSpec, SharpenSpec, VideoDenoiseSpec

Floats = NDArray[np.float32]

REACH_SIGMAS = 4.0


def denoised(picture: Floats, spec: DenoiseSpec | None) -> Floats:
    """Smooth small differences to the surroundings, and keep large ones.

    The difference d to the smoothed picture is taken away by strength / (1 + (d / threshold)^2): coring (Simoncelli & Adelson
    1996, Proc. ICIP), which leaves stars and edges far above the threshold alone.

    Parameters
    ----------
    picture : (height, width) or (height, width, 3) array
        Shares of white.
    spec : DenoiseSpec or None
        None leaves it as it is.
    """
    if spec is None:
        return picture
    return picture - _cored(picture - _blurred(picture, spec.sigma_px), spec.strength, spec.threshold)


def averaged(picture: Floats, before: Floats | None, spec: VideoDenoiseSpec | None) -> Floats:
    """Average a frame of a video with the averaged one before it: a recursive filter, with the same coring.

    Of still light with white noise the variance is (1 - w) / (1 + w), w being the share of the frame before.
    """
    if spec is None or before is None or not spec.temporal:
        return picture
    return picture - _cored(picture - before, spec.temporal, spec.threshold)


def _cored(difference: Floats, strength: float, threshold: float | None) -> Floats:
    """The part of a difference that is taken away."""
    if threshold is None:
        return np.float32(strength) * difference
    return np.float32(strength) * difference / (1 + np.square(difference / np.float32(threshold)))


def sharpened(picture: Floats, spec: SharpenSpec | None) -> Floats:
    """Unsharp mask: the difference to a blurred picture, times the amount, is added."""
    if spec is None:
        return picture
    return picture + np.float32(spec.amount) * (picture - _blurred(picture, spec.sigma_px))


def _blurred(picture: Floats, sigma_px: float) -> Floats:
    sigma = (sigma_px, sigma_px) + (0,) * (picture.ndim - 2)
    return gaussian_filter(picture, sigma, mode="nearest", truncate=REACH_SIGMAS)
