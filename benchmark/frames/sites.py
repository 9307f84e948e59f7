"""Which frames are counted together: those of one place and night, and all frames of a sequence."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from benchmark.frames.conditions import site_of
from benchmark.frames.dataset import Frame


def own_site(frame: Frame) -> str:
    """Name of the place and night of a frame by itself."""
    where = frame.conditions
    return site_of(where.latitude_deg, where.longitude_deg, frame.observation.utc)


def counted_site(frame: Frame) -> str:
    """The place and night that a frame is counted with."""
    return own_site(frame) if frame.site is None else frame.site


def with_sites(frames: Iterable[Frame]) -> list[Frame]:
    """Frames that know the site they are counted with: of a sequence that of its first frame.

    A camera that moves is at another place in each frame, under the same weather and sky: its frames are no independent
    trials. Sequences that begin at one place in one night share these as well, and are one site.
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
