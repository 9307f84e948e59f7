"""A start from nothing: focal length and attitude from the middle of one frame.

Around the axis all lenses are alike but for their scale: r = f theta up to the third order of theta. So the detections of a
disk about the middle of the frame, whose radius is a fixed angle of the focal length that is tried, are identified among all
stars of the sky (`celnav.identification`), for focal lengths in steps of 12 %. An identification is accepted at the solver's
own bound of false alarms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.frames import CalibrationFrame, Sky
from celnav.camera import Camera
from celnav.identification.effort import Effort
from celnav.identification.identify import Question, identify
from celnav.identification.search_config import SearchConfig
from celnav.identification.sky_index import load_sky_index

F8 = NDArray[np.float64]

MOST_DETECTIONS = 200
FEWEST_DETECTIONS = 8
# Look-ups (celnav.identification.effort): 0.03 s for each focal length.
WORK = 4_000_000


@dataclass(frozen=True)
class Pass:
    """Radius of the disk, in focal lengths; range of focal lengths, in the frame's shorter side; step, and work for each.

    `frames` is the most frames that it is tried on.
    """

    reach_rad: float
    shortest: float
    longest: float
    step: float
    work: int
    frames: int


# From an image circle of 180 deg over a third of the frame to 5 deg across it. Where clutter is bright or stars are few,
# finer steps and more work find what the first passes miss. All together take 3.7e9 look-ups at most, and 1.6e9 of one frame,
# however many frames there are; those that are tried lie evenly in their order.
PASSES = (
    Pass(0.35, 0.1135, 11.0, 1.12, WORK, 12),
    Pass(0.5, 0.1135, 11.0, 1.12, WORK, 2),
    Pass(0.35, 0.5, 11.0, 1.05, 5 * WORK, 1),
)


@dataclass(frozen=True, eq=False)
class Start:
    """Focal length and attitude, good near the middle of the frame.

    Attributes
    ----------
    camera : Camera
        Whose lens it is: the guess, its focal length corrected, or an equidistant lens.
    rotation : ndarray, shape (3, 3)
        East-north-up to camera.
    reach_px : float
        Radius about the middle within which it holds.
    stars : int
        Identified.
    """

    camera: Camera
    rotation: F8
    reach_px: float
    stars: int


def find_start(frame: CalibrationFrame, sky: Sky, passes: tuple[Pass, ...] = PASSES) -> Start | None:
    """Find focal length and attitude from nothing; None where the middle of the frame shows no stars to be named."""
    shorter = min(frame.size)
    for each in passes:
        steps = int(math.log(each.longest / each.shortest) / math.log(each.step)) + 1
        for step in range(steps):
            f_px = each.shortest * shorter * each.step**step
            camera = Camera("equidistant", *frame.size, f_px)
            if (found := identify_middle(frame, sky, camera, each.reach_rad * f_px, each.work)) is not None:
                return found
    return None


def is_mirrored(frame: CalibrationFrame, sky: Sky) -> bool:
    """Tell whether the stars of the frame are found once it is turned over: a picture whose rows run upwards."""
    uv = frame.uv * [1.0, -1.0] + [0.0, frame.size[1] - 1.0]
    turned = replace(frame, detections=replace(frame.detections, uv=uv))
    return find_start(turned, sky, PASSES[:1]) is not None


def identify_middle(
    frame: CalibrationFrame, sky: Sky, camera: Camera, reach_px: float, work: int = WORK
) -> Start | None:
    """Name the detections within `reach_px` of the middle of the frame with a camera whose focal length is 6 % good."""
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
    if found is None:
        return None
    scale = math.exp(found.log_f)
    fitted = replace(camera, f_px=camera.f_px * scale, fy_px=camera.fy_px * scale)
    return Start(fitted, found.rotation @ sky.enu_of_icrs.T, reach_px, len(found.detection))
