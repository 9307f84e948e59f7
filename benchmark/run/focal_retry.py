"""Retries of refused frames with other focal lengths, the same for all contestants that do not search by themselves.

The tries share the frame's time. Each receives its share of the remaining time, so that a search that the clock ends uses no
more than that and leaves some for the tries after it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from benchmark.frames.dataset import Frame

FOCAL_FACTORS = (0.88, 1.13)
"""Factors on the supplied focal length, in order; those of celnav's default solver (`celnav.skybench_solver`)."""
FIRST_SHARE = 0.6
"""Share of the frame's time for the supplied focal length, which is right most often; the others divide the rest."""


def shares(retries: bool) -> tuple[float, ...]:
    """Largest share of the remaining time for each try, in order."""
    if not retries:
        return (1.0,)
    others = len(FOCAL_FACTORS)
    return (FIRST_SHARE, *(1.0 / (others - done) for done in range(others)))


def at_other_focal_lengths(frame: Frame) -> Iterator[Frame]:
    """Yield the frame with other focal lengths, to be tried after the supplied one."""
    told = frame.observation
    for factor in FOCAL_FACTORS:
        camera = dataclasses.replace(told.camera, f_px=factor * told.camera.f_px, fy_px=factor * told.camera.fy_px)
        yield dataclasses.replace(frame, observation=dataclasses.replace(told, camera=camera))
