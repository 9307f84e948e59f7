"""Selection of the pixels of a sensor that have a rare property."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def rare_pixels(random: np.random.Generator, size: int, fraction: float) -> NDArray[np.intp]:
    """Flat indices, in order, of pixels that independently have a property with a given probability, (n,) array.

    They are drawn by the gaps between them, which are geometrically distributed (Devroye 1986, "Non-Uniform Random
    Variate Generation", XII.1), so the time is proportional to their number and not to the size of the sensor.

    Parameters
    ----------
    random : Generator
    size : int
        Number of pixels.
    fraction : float
        Probability, 0 to 1.
    """
    if fraction <= 0:
        return np.zeros(0, np.intp)
    places: list[NDArray[np.intp]] = []
    last = -1
    while last < size:
        expected = (size - last) * fraction
        # One draw is enough except in one case in a billion.
        gaps = random.geometric(fraction, math.ceil(expected + 6 * math.sqrt(expected)) + 6)
        # A longer gap leads beyond the sensor as well, and tiny fractions have gaps whose sum exceeds 64 bits.
        gaps = np.minimum(gaps, size + 1)
        places.append(last + np.cumsum(gaps, dtype=np.intp))
        last = int(places[-1][-1])
    found = np.concatenate(places)
    return found[: np.searchsorted(found, size)]
