"""Sites: frames that are counted together because they are of one place and night, or of one sequence."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from benchmark.frames.conditions import site_of
from benchmark.frames.dataset import Frame


def own_site(frame: Frame) -> str:
    """Name of the place and night of a single frame."""
    where = frame.conditions
    return site_of(where.latitude_deg, where.longitude_deg, frame.observation.utc)


def counted_site(frame: Frame) -> str:
    """Name of the place and night with which a frame is counted."""
    return own_site(frame) if frame.site is None else frame.site


def with_sites(frames: Iterable[Frame]) -> list[Frame]:
    """Give each frame the site with which it is counted; frames of a sequence get that of its first frame.

    A moving camera is at another place in each frame, but under the same weather and sky, so its frames are not independent
    trials. Sequences that begin at one place in one night share weather and sky as well, and are one site.
    """
    found = list(frames)
    first: dict[int, Frame] = {}
    for frame in found:
        if frame.step is not None:
            known = first.setdefault(frame.step.sequence, frame)
            if known.step is not None and frame.step.step < known.step.step:
                first[frame.step.sequence] = frame
    return [
        dataclasses.replace(frame, site=own_site(frame if frame.step is None else first[frame.step.sequence]))
        for frame in found
    ]
