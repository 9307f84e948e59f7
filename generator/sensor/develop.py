"""From raw DN to an 8-bit picture: black level, demosaic, white balance, gamma."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from generator.scenario.sensor_spec import COLOURS, SensorSpec
from generator.sensor.colour import filter_array

Floats = NDArray[np.float64]

KERNEL: Floats = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4


def develop(dn: NDArray[np.uint16], sensor: SensorSpec) -> NDArray[np.uint8]:
    """Develop a raw frame as the sensor's `develop` section asks (it must be given).

    Parameters
    ----------
    dn : (height, width) uint16 array
    sensor : SensorSpec

    Returns
    -------
    (height, width, 3) uint8 array, or (height, width) of a monochrome sensor
        Red, green, blue; sRGB's transfer curve (IEC 61966-2-1) unless linear.
    """
    if sensor.develop is None:
        raise ValueError("the sensor has no develop section")
    largest = 2**sensor.bits - 1 - sensor.black_level_dn
    light = np.clip((dn.astype(np.float64) - sensor.black_level_dn) / largest, 0, 1)
    picture = light if sensor.colour is None else demosaic(light, sensor.colour.pattern)
    if sensor.colour is not None:
        balance = sensor.develop.white_balance or grey_world(picture)
        picture = picture * np.array(balance)
    picture = np.clip(picture * sensor.develop.exposure, 0, 1)
    if sensor.develop.gamma == "srgb":
        picture = np.where(picture <= 0.0031308, 12.92 * picture, 1.055 * picture ** (1 / 2.4) - 0.055)
    return np.rint(255 * picture).astype(np.uint8)


def demosaic(light: Floats, pattern: str) -> Floats:
    """Bilinear interpolation of each colour from its own pixels: (height, width, 3) red, green, blue."""
    array = filter_array(pattern, *light.shape)
    planes = []
    for colour in ("red", "green", "blue"):
        own = (array == COLOURS.index(colour)).astype(np.float64)
        near = ndimage.convolve(own, KERNEL, mode="mirror")
        planes.append(ndimage.convolve(light * own, KERNEL, mode="mirror") / near)
    return np.stack(planes, axis=-1)


def grey_world(picture: Floats) -> tuple[float, float, float]:
    """Factors that give all colours green's median, which on a frame of the night is the sky's."""
    red, green, blue = (max(float(np.median(picture[..., channel])), 1e-6) for channel in range(3))
    return green / red, 1.0, green / blue
