"""Blind start of a calibration: focal length and attitude from the centre of one frame, without prior knowledge.

Near the axis all lenses are alike except for their scale: r = f theta up to the third order of theta. The detections in a
disk about the centre of the frame are therefore identified among all stars of the sky (`celnav.identification`) for focal
lengths in steps of 12 %; the radius of the disk is a fixed angle at the focal length that is tried. Fields below some 20 deg
are identified by the shapes of triangles, for all focal lengths at once (`celnav.identification.triangles`). An
identification is accepted at the solver's own false-alarm bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.frames import CalibrationFrame, Sky, apparent
from celnav.camera import Camera
from celnav.field_stars import aberrated
from celnav.identification.effort import Effort
from celnav.identification.identify import identify
from celnav.identification.question import Question
from celnav.identification.search_config import SearchConfig
from celnav.identification.sky_index import NARROW, load_sky_index
from celnav.identification.triangles import find_narrow_field
from celnav.identification.verification import Alignment, rotation_of

F8 = NDArray[np.float64]

MOST_DETECTIONS = 200
FEWEST_DETECTIONS = 8
# Work for each focal length, in look-ups (celnav.identification.effort); it takes 0.03 s.
WORK = 4_000_000


# Look-ups of one search for a narrow field: three times the largest number that a successful search needed.
NARROW_WORK = 120_000_000
# Range of focal lengths of narrow fields, in units of the frame's shorter side: 23 to 2.2 deg across that side.
NARROW_FOCAL = (2.4, 26.0)
# Factor by which a guess of the focal length may be off.
_GUESSED = 1.07


@dataclass(frozen=True)
class Pass:
    """One pass of the search: radius of the disk, range and step of focal lengths, and work for each of them.

    The radius is in focal lengths, the range in units of the frame's shorter side. `frames` is the largest number of frames
    that the pass tries. A reach of 0 stands for a search for a narrow field, by triangles of the whole frame.
    """

    reach_rad: float
    shortest: float
    longest: float
    step: float
    work: int
    frames: int


# The passes cover the range from an image circle of 180 deg over a third of the frame to 14 deg across the frame, and narrow
# fields down to 2.2 deg. Where clutter is bright or stars are few, finer steps and more work find what the first passes miss.
# All passes together take at most 3.3e9 look-ups, and 1.3e9 for a single frame, however many frames there are. The frames
# that are tried are spaced evenly in their order.
PASSES = (
    Pass(0.35, 0.1135, 4.0, 1.12, WORK, 12),
    Pass(0.0, *NARROW_FOCAL, 0.0, NARROW_WORK, 5),
    Pass(0.5, 0.1135, 4.0, 1.12, WORK, 2),
    Pass(0.35, 0.5, 4.0, 1.05, 5 * WORK, 1),
)


@dataclass(frozen=True, eq=False)
class Start:
    """Focal length and attitude that hold near the centre of the frame.

    Attributes
    ----------
    camera : Camera
        The guess with its focal length corrected, or a camera with an equidistant lens.
    rotation : ndarray, shape (3, 3)
        East-north-up to camera.
    reach_px : float
        Radius about the centre within which the start holds, pixels.
    stars : int
        Number of identified stars.
    """

    camera: Camera
    rotation: F8
    reach_px: float
    stars: int


def find_start(frame: CalibrationFrame, sky: Sky, passes: tuple[Pass, ...] = PASSES) -> Start | None:
    """Find focal length and attitude without prior knowledge; None if the centre of the frame cannot be identified."""
    shorter = min(frame.size)
    for each in passes:
        if each.reach_rad == 0:
            focal_px = each.shortest * shorter, each.longest * shorter
            if (found := identify_narrow(frame, sky, focal_px, each.work)) is not None:
                return found
            continue
        steps = int(math.log(each.longest / each.shortest) / math.log(each.step)) + 1
        for step in range(steps):
            f_px = each.shortest * shorter * each.step**step
            camera = Camera("equidistant", *frame.size, f_px)
            if (found := identify_middle(frame, sky, camera, each.reach_rad * f_px, each.work)) is not None:
                return found
    return None


def is_mirrored(frame: CalibrationFrame, sky: Sky) -> bool:
    """Return whether the stars are identified once the frame is flipped, as for a picture whose rows run upwards."""
    uv = frame.uv * [1.0, -1.0] + [0.0, frame.size[1] - 1.0]
    turned = replace(frame, detections=replace(frame.detections, uv=uv))
    return find_start(turned, sky, PASSES[:3]) is not None


def is_narrow(camera: Camera) -> bool:
    """Return whether the camera's field is so small that it counts as narrow."""
    return NARROW * camera.solid_angle_sr < 4 * math.pi


def identify_with(frame: CalibrationFrame, sky: Sky, camera: Camera, reach_px: float) -> Start | None:
    """Identify the detections within `reach_px` of the frame's centre with a camera of focal length known to 6 %."""
    if not is_narrow(camera):
        return identify_middle(frame, sky, camera, reach_px)
    f_px = math.sqrt(camera.f_px * camera.fy_px)
    found = identify_narrow(frame, sky, (f_px / _GUESSED, f_px * _GUESSED), NARROW_WORK)
    if found is None:
        return None
    scale = found.camera.f_px / f_px
    return replace(found, camera=replace(camera, f_px=camera.f_px * scale, fy_px=camera.fy_px * scale))


def identify_narrow(frame: CalibrationFrame, sky: Sky, focal_px: tuple[float, float], work: int) -> Start | None:
    """Identify the detections of a narrow field whose focal length is in a given range."""
    if len(frame.uv) < FEWEST_DETECTIONS:
        return None
    found = find_narrow_field(frame.uv, frame.size, focal_px, Effort(work), SearchConfig())
    return None if found is None else _started(frame, sky, found[0], found[1], math.hypot(*frame.size) / 2)


def identify_middle(
    frame: CalibrationFrame, sky: Sky, camera: Camera, reach_px: float, work: int = WORK
) -> Start | None:
    """Identify the detections of a field that is not narrow, as `identify_with` does, with bounded work."""
    width, height = frame.size
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    near = np.flatnonzero(np.hypot(*(frame.uv - middle).T) <= reach_px)[:MOST_DETECTIONS]
    rays = camera.to_rays(frame.uv[near])
    seen = np.isfinite(rays[:, 0])
    near, rays = near[seen], rays[seen]
    if len(near) < FEWEST_DETECTIONS:
        return None
    area_px = min(math.pi * reach_px**2, float(width * height))
    question = Question(
        camera, frame.uv[near], rays, frame.detections.flux is not None, area_px / (camera.f_px * camera.fy_px), area_px,
        None, np.eye(3), None, None,
    )  # fmt: skip
    found = identify(question, load_sky_index(), SearchConfig(), Effort(work)).alignment
    return None if found is None else _started(frame, sky, camera, found, reach_px)


def _started(frame: CalibrationFrame, sky: Sky, camera: Camera, found: Alignment, reach_px: float) -> Start:
    """Convert an orientation relative to catalogue positions to one relative to apparent positions.

    With a long lens, aberration and refraction shift a narrow field by many pixels.
    """
    scale = math.exp(found.log_f)
    fitted = replace(camera, f_px=camera.f_px * scale, fy_px=camera.fy_px * scale)
    rotation = aberrated(found.rotation, camera, frame.utc) @ sky.enu_of_icrs.T
    true = rotation.T @ camera.to_rays([[(camera.width - 1) / 2, (camera.height - 1) / 2]])[0]
    if true[2] > 0.05:
        rotation = rotation @ rotation_of(np.cross(true, apparent(true[None], sky.site.weather)[0])).T
    return Start(fitted, rotation, reach_px, len(found.detection))
