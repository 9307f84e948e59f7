"""Which pixels of a sensor have a rare property."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def rare_pixels(random: np.random.Generator, size: int, fraction: float) -> NDArray[np.intp]:
    """Flat places, in order, of pixels that have a property with a probability, each by itself, (n,) array.

    Drawn by the gaps between them, which are geometric (Devroye 1986, "Non-Uniform Random Variate Generation", XII.1), so
    that the time goes as their number, not as the sensor's.

    Parameters
    ----------
    random : Generator
    size : int
        Pixels.
    fraction : float
        0 to 1.
    """
    if fraction <= 0:
        return np.zeros(0, np.intp)
    places: list[NDArray[np.intp]] = []
    last = -1
    while last < size:
        expected = (size - last) * fraction
        # One draw is enough but for one case in a billion.
        gaps = random.geometric(fraction, math.ceil(expected + 6 * math.sqrt(expected)) + 6)
        places.append(last + np.cumsum(gaps, dtype=np.intp))
        last = int(places[-1][-1])
    found = np.concatenate(places)
    return found[: np.searchsorted(found, size)]
