"""Development of raw DN to an 8-bit picture: black level, demosaicing, white balance, exposure, noise, curve, sharpness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.colour_science import colour_demosaicing, srgb_encoded
from generator.scenario.processing.develop_spec import LARGEST_FACTOR, DevelopSpec
from generator.scenario.sensor_spec import SensorSpec
from generator.sensor.processing import denoised, sharpened

Floats = NDArray[np.float64]

MARGIN_PX = 2
"""Mirrored pixels around the frame, an even number so that the pattern starts with the same colours; the kernels of bilinear
demosaicing reach one pixel."""
AUTO_LEVEL = 0.04
"""Linear level of the sky with automatic exposure, a grey of 56 of 255 after sRGB's transfer curve."""
AUTO_PERCENTILE = 99
"""Percentile above which pixels count as stars."""
ROWS_AT_ONCE = 64
"""Rows encoded in one step, so that the data fit into the processor's cache, which is eight times faster."""


def develop(dn: NDArray[np.uint16], sensor: SensorSpec) -> NDArray[np.uint8]:
    """Develop a raw frame as the sensor's `develop` section specifies.

    Parameters
    ----------
    dn : (height, width) uint16 array
    sensor : SensorSpec
        Sensor with a `develop` section.

    Returns
    -------
    (height, width, 3) uint8 array, or (height, width) for a monochrome sensor
        Red, green, blue; with sRGB's transfer curve (IEC 61966-2-1) unless the section has another.

    Raises
    ------
    ValueError
        The sensor has no `develop` section.
    """
    if sensor.develop is None:
        raise ValueError("the sensor has no develop section")
    largest = 2**sensor.bits - 1 - sensor.black_level_dn
    light = np.clip((dn.astype(np.float64) - sensor.black_level_dn) / largest, 0, 1)
    balance = np.ones(1)
    if sensor.colour is not None:
        light = demosaic(light, sensor.colour.pattern)
        balance = np.array(sensor.develop.white_balance or grey_world(light))
    exposure = sensor.develop.exposure
    gain = balance * (automatic_exposure(light * balance) if exposure == "auto" else exposure)
    if sensor.develop.denoise is not None:
        light = denoised((light * gain).astype(np.float32), sensor.develop.denoise).astype(np.float64)
        gain = np.ones(1)
    shown = np.empty(light.shape, np.float32)
    for start in range(0, len(light), ROWS_AT_ONCE):
        rows = slice(start, start + ROWS_AT_ONCE)
        shown[rows] = transferred(np.clip(light[rows] * gain, 0, 1), sensor.develop)
    return np.rint(255 * np.clip(sharpened(shown, sensor.develop.sharpen), 0, 1)).astype(np.uint8)


def transferred(linear: Floats, spec: DevelopSpec) -> Floats:
    """Apply the transfer curve to linear values from 0 to 1; the result is from 0 to 1."""
    if spec.gamma == "srgb":
        return srgb_encoded(linear)
    return linear if spec.gamma == "linear" else linear ** (1 / float(spec.gamma))


def automatic_exposure(light: Floats) -> float:
    """Factor that brings the sky of a frame to AUTO_LEVEL; at least 1, so that white stays white.

    The sky's level is the mean of the pixels from the median to the 99th percentile, which excludes stars and includes
    noise. A mean follows slow changes without steps, so that a video of individually developed frames does not flicker.

    Parameters
    ----------
    light : (height, width) or (height, width, 3) array
        Fractions of full scale, linear, with white balance applied.
    """
    values = np.sort(light, axis=None)
    sky = values[len(values) // 2 : max(len(values) // 2 + 1, int(AUTO_PERCENTILE / 100 * len(values)))]
    return float(np.clip(AUTO_LEVEL / max(float(sky.mean()), AUTO_LEVEL / LARGEST_FACTOR), 1.0, LARGEST_FACTOR))


def demosaic(light: Floats, pattern: str) -> Floats:
    """Bilinear interpolation of each colour between its own pixels: (height, width, 3) red, green, blue.

    A pixel keeps the value that it measured. Source: Losson, Macaire & Yang 2010, Advances in Imaging and Electron
    Physics 162, 173, as colour-demosaicing implements it. Among its other methods, Malvar's undershoots around
    undersampled stars, down to a quarter of white below black; Menon's is more accurate, at many times the cost.
    """
    # The library mirrors at the border regardless of the pattern, so it would mix colours there.
    wide = np.pad(light, MARGIN_PX, mode="reflect")
    inside = slice(MARGIN_PX, -MARGIN_PX)
    planes: Floats = colour_demosaicing().demosaicing_CFA_Bayer_bilinear(wide, pattern)
    return planes[inside, inside]


def grey_world(picture: Floats) -> tuple[float, float, float]:
    """Factors that bring all colours to the median of green; at night this makes the sky grey."""
    red, green, blue = (max(float(np.median(picture[..., channel])), 1e-6) for channel in range(3))
    return green / red, 1.0, green / blue
