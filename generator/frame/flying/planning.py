"""All flying objects of a frame, in the order of the scenario, and the false stars after them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.frame.flying.objects import KEYFRAMES, FlyingObjects, joined, none, steady
from generator.frame.flying.orbits import Watch, shell_objects, tle_object
from generator.frame.flying.trails import trail_objects, train_objects
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.foreground_spec import ForegroundSpec, GlintsSpec

Floats = NDArray[np.float64]


def plan_objects(spec: ForegroundSpec, watch: Watch) -> FlyingObjects:
    """Plan the objects of a frame: trails, satellites from element sets, trains and shells.

    Raises
    ------
    ScenarioError
        SGP4 cannot propagate an element set, or flashes are too short for the time over which they go on.
    """
    groups = trail_objects(spec.trails, watch.shutter_s, watch.horizon_sine)
    for number, satellite in enumerate(spec.satellites):
        groups.append(tle_object(satellite, number, len(groups), watch))
    first = len(groups)
    for train in spec.trains:
        groups.append(train_objects(train, first, watch.shutter_s, watch.horizon_sine))
        first += train.count
    for number, shell in enumerate(spec.shells):
        groups.append(shell_objects(shell, number, first, watch))
        first += shell.count
    return joined(groups) if groups else none()


def plan_glints(
    spec: GlintsSpec, camera: CameraSpec, R_cam: Floats, first: int, rng: np.random.Generator
) -> FlyingObjects:
    """Plan false stars, uniform over the image's pixels; for a lens with decentring, some are slightly outside the image.

    Parameters
    ----------
    spec : GlintsSpec
    camera : CameraSpec
    R_cam : (3, 3) array
        East-north-up to camera.
    first : int
        Number of the first.
    rng : Generator
    """
    lens, count = camera.projection, spec.count
    u, v = rng.uniform(-0.5, camera.width - 0.5, count), rng.uniform(-0.5, camera.height - 0.5, count)
    v_mag = rng.uniform(*spec.v_mag, count)
    x, y = (u - lens.cx_px) / lens.f_px, (v - lens.cy_px) / lens.fy_px
    angle = np.radians(lens.axis_angles_deg(np.hypot(x, y)))
    around = np.arctan2(y, x)
    in_camera = np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], axis=1)
    lit, parts, curve = steady(count)
    return FlyingObjects(
        number=first + np.arange(count, dtype=np.int32),
        kind=("glint",) * count,
        v_mag=v_mag,
        bv_mag=np.full(count, spec.bv_mag),
        lit=lit,
        directions=np.repeat((in_camera @ R_cam)[:, None], KEYFRAMES, axis=1),
        parts=parts,
        light_curve=curve,
    )
