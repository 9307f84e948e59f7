"""Refused frames tried again with other focal lengths, in one way for all contestants that do not search by themselves."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from benchmark.frames.dataset import Frame

FOCAL_FACTORS = (0.88, 1.13)
"""Of the told focal length, in this order: those of celnav's default solver (`celnav.skybench_solver`)."""


def at_other_focal_lengths(frame: Frame) -> Iterator[Frame]:
    """The frame as it is told with other focal lengths, to be tried after the told one."""
    told = frame.observation
    for factor in FOCAL_FACTORS:
        camera = dataclasses.replace(told.camera, f_px=factor * told.camera.f_px, fy_px=factor * told.camera.fy_px)
        yield dataclasses.replace(frame, observation=dataclasses.replace(told, camera=camera))
