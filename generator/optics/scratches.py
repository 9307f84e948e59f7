"""Scratches, chips and dirt of a dome: streaks and specks of light around bright sources, fixed to the dome.

A scratch scatters light into a narrow fan of directions (Bosch et al. 2004, Computer Graphics Forum 23(3), 361), so that
a few of many shine at a time, and others as the source moves. The law here is skybench's own, after the statistics of two
photographs of an all-sky camera under the Moon: streaks are at random angles to the direction of the Moon, none visibly
shines in both, and their light per area at 26, 34 and 47 deg from the Moon is 0.8, 0.4 and 0.1 of that at 19 deg,
modelled by (1 + (angle / 25 deg)^2)^-2. Dirt is modelled likewise with short and wide streaks, wider lobes and a slower
decrease: structures 2 to 16 px wide in those photographs fall as (angle)^-1.3 from 20 to 70 deg from the Moon, and a
third of them shine in both. The light is added: less than a thousandth of the source's by scratches, less than a
hundredth by dirt.

Marks on a dome (`before_lens`) are lit by the source in the sky, however much the lens vignettes its image, and are seen
through the lens at their own place: both ends of the path follow from radiometry, without further parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from generator.scenario.camera_spec import CameraSpec
from generator.scenario.lens.stray_light_spec import ScratchSpec

Floats = NDArray[np.float64]
LensLight = Callable[[Floats, Floats], Floats]
LEAST_ELECTRONS = 1.0
"""Least electrons of a streak; fainter ones are not drawn, and sources that give less on average are skipped."""
REACH_SIGMAS = 4.0
SOURCES_AT_ONCE = 64
STEP_PX = 0.5
SHARED_PX2 = 1 / 6
"""Variance along an axis of a point that is distributed over the adjacent pixels, mean over its places."""
CELL_PX = 8.0
"""Side of the cells in which sources are gathered, because the Moon's disk and its moments are many points."""
LEAST_LENS_LIGHT = 0.05
"""Least relative light of the lens at a source's place: where the lens passes almost nothing, nothing is known of the
source."""


def scratch_light(
    spec: ScratchSpec,
    points: Sequence[tuple[Floats, Floats, Floats]],
    camera: CameraSpec,
    random: np.random.Generator,
    lens_light: LensLight | None = None,
) -> NDArray[np.float32]:
    """Electrons that scratches send to each pixel, (channels, height, width).

    Parameters
    ----------
    spec : ScratchSpec
    points : sequence of (u, v, electrons)
        Sources, px, inside or outside the frame, NaN where the lens images nothing: (m,), (m,), (m, channels) arrays.
    camera : CameraSpec
    random : Generator
        Random generator of the camera, the same for all its frames.
    lens_light : callable, optional
        Function of places u, v, px, (n,) arrays: fraction of the light on the axis that the lens passes there, (n,)
        array. It is used for marks with `before_lens`; without it the lens passes all light everywhere.
    """
    u, v = random.uniform(0, camera.width, spec.number) - 0.5, random.uniform(0, camera.height, spec.number) - 0.5
    direction, turn = random.uniform(0, math.pi, spec.number), random.uniform(-math.pi, math.pi, spec.number)
    length = spec.length_px * np.clip(random.exponential(1.0, spec.number), 0.2, 4.0)
    strength = spec.strength * random.exponential(1.0, spec.number)
    middle = camera.projection
    if camera.image_circle_px is not None:
        strength = strength * (np.hypot(u - middle.cx_px, v - middle.cy_px) < camera.image_circle_px)
    dimmed = lens_light if spec.before_lens else None
    if dimmed is not None:
        strength = strength * dimmed(u, v)
    channels = points[0][2].shape[1] if points else 1
    light = np.zeros((spec.number, channels))
    for point in points:
        source_u, source_v, electrons = _gathered(*point)
        if dimmed is not None and len(source_u):
            kept = dimmed(source_u, source_v)
            electrons = (
                np.where(kept > LEAST_LENS_LIGHT, 1 / np.maximum(kept, LEAST_LENS_LIGHT), 0)[:, None] * electrons
            )
        rows = np.nonzero(electrons.max(axis=1, initial=0) * spec.strength >= LEAST_ELECTRONS)[0]
        for start in range(0, len(rows), SOURCES_AT_ONCE):
            some = rows[start : start + SOURCES_AT_ONCE]
            du, dv = u[:, None] - source_u[some], v[:, None] - source_v[some]
            angle = np.hypot(du, dv) / middle.f_px
            off = np.abs(np.angle(np.exp(1j * (np.arctan2(dv, du) - turn[:, None])))) / math.radians(spec.lobe_deg)
            fall = (1 + (angle / math.radians(spec.core_deg)) ** 2) ** (-0.5 * spec.slope)
            share = strength[:, None] * np.exp(-0.5 * off**2) * fall
            light += share @ electrons[some]
    shining = np.nonzero(light.max(axis=1, initial=0) >= LEAST_ELECTRONS)[0]
    lines = _Lines(u[shining], v[shining], direction[shining], length[shining])
    return np.stack([_drawn(lines, each, spec.width_px, camera) for each in light[shining].T])


def _gathered(u: Floats, v: Floats, electrons: Floats) -> tuple[Floats, Floats, Floats]:
    """Gather sources as sums over cells."""
    imaged = np.isfinite(u + v)
    places, cell = np.unique(np.floor(np.stack([u, v], axis=1)[imaged] / CELL_PX), axis=0, return_inverse=True)
    light = np.zeros((len(places), electrons.shape[1]))
    np.add.at(light, cell.ravel(), electrons[imaged])
    return (places[:, 0] + 0.5) * CELL_PX, (places[:, 1] + 0.5) * CELL_PX, light


@dataclass(frozen=True, eq=False)
class _Lines:
    """Centres, directions (rad) and lengths of lines, px, (n,) arrays."""

    u: Floats
    v: Floats
    direction: Floats
    length: Floats


def _drawn(lines: _Lines, light: Floats, sigma: float, camera: CameraSpec) -> NDArray[np.float32]:
    """Evenly lit lines with a Gaussian profile: points at most `STEP_PX` apart, each spread over four pixels, smoothed."""
    rim = math.ceil(REACH_SIGMAS * sigma + lines.length.max(initial=0) / 2) + 1
    points = np.ceil(lines.length / STEP_PX).astype(int)
    line = np.repeat(np.arange(len(points)), points)
    number = np.arange(len(line)) - np.repeat(np.cumsum(points) - points, points)
    along = ((number + 0.5) / points[line] - 0.5) * lines.length[line]
    u = lines.u[line] + along * np.cos(lines.direction[line]) + rim
    v = lines.v[line] + along * np.sin(lines.direction[line]) + rim
    height, width = camera.height + 2 * rim, camera.width + 2 * rim
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    right, low = u - left, v - top
    each = light[line] / points[line]
    picture = np.zeros(height * width)
    for du, dv, part in (
        (0, 0, (1 - right) * (1 - low)),
        (1, 0, right * (1 - low)),
        (0, 1, (1 - right) * low),
        (1, 1, right * low),
    ):
        picture += np.bincount((top + dv) * width + left + du, each * part, height * width)
    smoothed = gaussian_filter(
        picture.reshape(height, width).astype(np.float32),
        math.sqrt(sigma**2 - SHARED_PX2),
        mode="constant",
        truncate=REACH_SIGMAS,
    )
    return np.asarray(smoothed[rim:-rim, rim:-rim])
