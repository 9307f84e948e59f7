"""A colour sensor's filter array: the channel that each pixel records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.scenario.sensor_spec import COLOURS, SensorSpec

LETTERS = {"B": COLOURS.index("blue"), "G": COLOURS.index("green"), "R": COLOURS.index("red")}


def filter_tile(pattern: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Channel (index into COLOURS) of the first 2 x 2 pixels, which `pattern` names row by row."""
    first, second, third, fourth = (LETTERS[letter] for letter in pattern)
    return (first, second), (third, fourth)


def filter_array(pattern: str, height: int, width: int) -> NDArray[np.intp]:
    """Channel (index into COLOURS) of every pixel, (height, width); `pattern` names the first 2 x 2 row by row."""
    tile = np.array(filter_tile(pattern), dtype=np.intp)
    return np.tile(tile, ((height + 1) // 2, (width + 1) // 2))[:height, :width]


def mosaic(image: NDArray[np.float32], sensor: SensorSpec) -> NDArray[np.float32]:
    """Values (height, width) that the pixels record of an image (height, width, channels); each records one channel."""
    if sensor.colour is None or image.shape[2] == 1:
        return np.ascontiguousarray(image[:, :, 0])
    chosen = filter_array(sensor.colour.pattern, *image.shape[:2])
    return np.take_along_axis(image, chosen[:, :, None], axis=2)[:, :, 0]


def channel_weights(sensor: SensorSpec) -> NDArray[np.float64]:
    """Fraction of the pixels of each channel, (channels,)."""
    return np.array([1.0]) if sensor.colour is None else np.array([0.25, 0.5, 0.25])
