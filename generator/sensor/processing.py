"""Processing of a picture in a camera: noise reduction and sharpening."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from generator.scenario.processing.video_spec import DenoiseSpec, SharpenSpec, VideoDenoiseSpec

Floats = NDArray[np.float32]

REACH_SIGMAS = 4.0


def denoised(picture: Floats, spec: DenoiseSpec | None) -> Floats:
    """Smooth small differences from the surroundings, and keep large ones.

    The fraction strength / (1 + (d / threshold)^2) of the difference d from the smoothed picture is removed. This is
    coring (Simoncelli & Adelson 1996, Proc. ICIP), which does not affect stars and edges far above the threshold.

    Parameters
    ----------
    picture : (height, width) or (height, width, 3) array
        Fractions of white.
    spec : DenoiseSpec or None
        Settings; None leaves the picture unchanged.
    """
    if spec is None:
        return picture
    return picture - _cored(picture - _blurred(picture, spec.sigma_px), spec.strength, spec.threshold)


def averaged(picture: Floats, before: Floats | None, spec: VideoDenoiseSpec | None) -> Floats:
    """Average a frame of a video with the averaged previous one: a recursive filter, with the same coring.

    For static light with white noise the variance is multiplied by (1 - w) / (1 + w), where w is the weight of the
    previous frame.
    """
    if spec is None or before is None or not spec.temporal:
        return picture
    return picture - _cored(picture - before, spec.temporal, spec.threshold)


def _cored(difference: Floats, strength: float, threshold: float | None) -> Floats:
    """The part of a difference that is removed."""
    if threshold is None:
        return np.float32(strength) * difference
    return np.float32(strength) * difference / (1 + np.square(difference / np.float32(threshold)))


def sharpened(picture: Floats, spec: SharpenSpec | None) -> Floats:
    """Apply an unsharp mask: the difference from a blurred picture, multiplied by the amount, is added."""
    if spec is None:
        return picture
    return picture + np.float32(spec.amount) * (picture - _blurred(picture, spec.sigma_px))


def _blurred(picture: Floats, sigma_px: float) -> Floats:
    sigma = (sigma_px, sigma_px) + (0,) * (picture.ndim - 2)
    return gaussian_filter(picture, sigma, mode="nearest", truncate=REACH_SIGMAS)
