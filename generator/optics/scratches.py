"""Scratches and chips of a dome: short streaks of light around bright sources, the same ones wherever a camera is.

A scratch scatters light into a narrow fan of directions (Bosch et al. 2004, Computer Graphics Forum 23(3), 361), so that a
few of many shine at a time, and others as the source moves. The law here is skybench's own, after the statistics of two
photographs of an all-sky camera under the Moon: streaks lie at random angles to the direction of the Moon, by eye none
shines in both, and their light per area at 26, 34 and 47 deg from the Moon is 0.8, 0.4 and 0.1 of that at 19 deg, here by
(1 + (angle / 25 deg)^2)^-2. Their light is added: less than a thousandth of the source's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.stray_light_spec import ScratchSpec

Floats = NDArray[np.float64]
CORE_RAD = math.radians(25.0)
"""Angle from a source at which a streak has a quarter of its light."""
LEAST_ELECTRONS = 1.0
"""Of a streak; fainter ones are not drawn, nor are sources looked at that give less on average."""
REACH_SIGMAS = 4.0
SOURCES_AT_ONCE = 64
CELL_PX = 8.0
"""Of the cells in which sources are gathered: the Moon's disk and its moments are many points."""


def scratch_light(
    spec: ScratchSpec, points: Sequence[tuple[Floats, Floats, Floats]], camera: CameraSpec, random: np.random.Generator
) -> NDArray[np.float32]:
    """Electrons that scratches send to each pixel, (channels, height, width).

    Parameters
    ----------
    spec : ScratchSpec
    points : sequence of (u, v, electrons)
        Sources, px, in the frame or not, NaN where the lens images nothing: (m,), (m,), (m, channels) arrays.
    camera : CameraSpec
    random : Generator
        Of the camera, the same for all its frames.
    """
    u, v = random.uniform(0, camera.width, spec.number) - 0.5, random.uniform(0, camera.height, spec.number) - 0.5
    direction, turn = random.uniform(0, math.pi, spec.number), random.uniform(-math.pi, math.pi, spec.number)
    length = spec.length_px * np.clip(random.exponential(1.0, spec.number), 0.2, 4.0)
    strength = spec.strength * random.exponential(1.0, spec.number)
    middle = camera.projection
    if camera.image_circle_px is not None:
        strength = strength * (np.hypot(u - middle.cx_px, v - middle.cy_px) < camera.image_circle_px)
    channels = points[0][2].shape[1] if points else 1
    light = np.zeros((spec.number, channels))
    for point in points:
        source_u, source_v, electrons = _gathered(*point)
        rows = np.nonzero(electrons.max(axis=1, initial=0) * spec.strength >= LEAST_ELECTRONS)[0]
        for start in range(0, len(rows), SOURCES_AT_ONCE):
            some = rows[start : start + SOURCES_AT_ONCE]
            du, dv = u[:, None] - source_u[some], v[:, None] - source_v[some]
            angle = np.hypot(du, dv) / middle.f_px
            off = np.abs(np.angle(np.exp(1j * (np.arctan2(dv, du) - turn[:, None])))) / math.radians(spec.lobe_deg)
            share = strength[:, None] * np.exp(-0.5 * off**2) / (1 + (angle / CORE_RAD) ** 2) ** 2
            light += share @ electrons[some]
    picture = np.zeros((channels, camera.height, camera.width), np.float32)
    for which in np.nonzero(light.max(axis=1, initial=0) >= LEAST_ELECTRONS)[0]:
        _draw(picture, light[which], u[which], v[which], direction[which], length[which], spec.width_px)
    return picture


def _gathered(u: Floats, v: Floats, electrons: Floats) -> tuple[Floats, Floats, Floats]:
    """Sources as sums over cells."""
    imaged = np.isfinite(u + v)
    places, cell = np.unique(np.floor(np.stack([u, v], axis=1)[imaged] / CELL_PX), axis=0, return_inverse=True)
    light = np.zeros((len(places), electrons.shape[1]))
    np.add.at(light, cell.ravel(), electrons[imaged])
    return (places[:, 0] + 0.5) * CELL_PX, (places[:, 1] + 0.5) * CELL_PX, light


def _draw(
    picture: NDArray[np.float32], light: Floats, u: float, v: float, direction: float, length: float, sigma: float
) -> None:
    """Add an evenly lit line with a Gaussian profile, of which pixels take what falls on their middles."""
    half = math.ceil(length / 2 + REACH_SIGMAS * sigma)
    columns = slice(max(0, math.floor(u) - half), max(0, math.ceil(u) + half + 1))
    rows = slice(max(0, math.floor(v) - half), max(0, math.ceil(v) + half + 1))
    du = np.arange(picture.shape[2])[columns] - u
    dv = (np.arange(picture.shape[1])[rows] - v)[:, None]
    along = du * math.cos(direction) + dv * math.sin(direction)
    across = dv * math.cos(direction) - du * math.sin(direction)
    wide = math.sqrt(2) * sigma
    ends = (erf((along + length / 2) / wide) - erf((along - length / 2) / wide)) / (2 * length)
    profile = ends * np.exp(-((across / wide) ** 2)) / (math.sqrt(math.pi) * wide)
    picture[:, rows, columns] += (light[:, None, None] * profile).astype(np.float32)
