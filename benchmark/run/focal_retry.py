"""Refused frames tried again with other focal lengths, in one way for all contestants that do not search by themselves.

The tries share the frame's time. Each is told its part of what is left of it, so that a search that is ended by the clock
takes what it may and leaves something to the tries after it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from benchmark.frames.dataset import Frame

FOCAL_FACTORS = (0.88, 1.13)
"""Of the told focal length, in this order: those of celnav's default solver (`celnav.skybench_solver`)."""
FIRST_SHARE = 0.6
"""Of the frame's time, for the told focal length, which is right more often than the others; these divide what is left."""


def shares(retries: bool) -> tuple[float, ...]:
    """Of the time that is left when it is asked, what each try should take at most."""
    if not retries:
        return (1.0,)
    others = len(FOCAL_FACTORS)
    return (FIRST_SHARE, *(1.0 / (others - done) for done in range(others)))


def at_other_focal_lengths(frame: Frame) -> Iterator[Frame]:
    """The frame as it is told with other focal lengths, to be tried after the told one."""
    told = frame.observation
    for factor in FOCAL_FACTORS:
        camera = dataclasses.replace(told.camera, f_px=factor * told.camera.f_px, fy_px=factor * told.camera.fy_px)
        yield dataclasses.replace(frame, observation=dataclasses.replace(told, camera=camera))
