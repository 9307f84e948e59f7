"""Dust on a dome, a window or the front of a lens: soft round shadows, out of focus.

A speck in front of the lens blocks the part of the pupil that it covers; its shadow is as wide as the pupil's footprint
on the surface with the speck, seen from the sensor. Light that it scatters is part of the lens' wings (`camera.bloom`,
`camera.dew`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from generator.scenario.lens.stray_light_spec import DustSpec

Floats = NDArray[np.float64]
LEAST_LIGHT = 0.2
"""Overlapping specks leave at least this fraction of the light."""


def dust_shadows(dust: DustSpec, width: int, height: int, random: np.random.Generator) -> NDArray[np.float32]:
    """Fraction of the light that passes the dust at each pixel, (height, width) array.

    Centres are uniform over the frame and its rim, depths are exponentially distributed about their mean, and a shadow
    falls off as a raised cosine.
    """
    rim = dust.diameter_px / 2
    left = np.ones((height, width))
    u = random.uniform(-rim, width + rim, dust.specks)
    v = random.uniform(-rim, height + rim, dust.specks)
    depth = random.exponential(dust.mean_depth, dust.specks)
    diameter = dust.diameter_px * random.uniform(0.7, 1.3, dust.specks)
    for place_u, place_v, part, across in zip(u, v, depth, diameter, strict=True):
        half = across / 2
        columns = slice(max(0, math.floor(place_u - half)), max(0, math.ceil(place_u + half) + 1))
        rows = slice(max(0, math.floor(place_v - half)), max(0, math.ceil(place_v + half) + 1))
        du = np.arange(width)[columns] - place_u
        dv = np.arange(height)[rows] - place_v
        radius = np.minimum(np.hypot(du, dv[:, None]) / half, 1)
        left[rows, columns] *= 1 - min(part, 1.0) * (0.5 + 0.5 * np.cos(math.pi * radius))
    return np.maximum(left, LEAST_LIGHT).astype(np.float32)
