"""Ratio of the rendering times of two kinds of frame, measured alternately."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass

from generator.dataset.images import encode
from generator.frame.render import render_frame
from generator.scenario.file import Scenario
from generator.speed.load import best_clock
from generator.speed.scenes import FULL_SKY, PLAIN_SKY, FrameSize, data_set, everything, moonlit

WARM_UP = 2


@dataclass(frozen=True)
class PairedTimes:
    """Seconds per frame, pair by pair, by :func:`generator.speed.load.best_clock`.

    Attributes
    ----------
    plain_s, full_s : tuple of float
    """

    plain_s: tuple[float, ...]
    full_s: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Median over pairs of the ratio of full to plain."""
        return statistics.median(full / plain for full, plain in zip(self.full_s, self.plain_s, strict=True))


def make_frame(scenario: Scenario, index: int) -> None:
    """Render a frame with its truth, and encode its image, as for a data set."""
    encode(render_frame(scenario, index, channels=False).dn, "png")


def time_pairs(plain: Callable[[int], None], full: Callable[[int], None], pairs: int) -> PairedTimes:
    """Time two kinds of frame k alternately, each first in every other pair.

    Frames are numbered from 0; those of the warm-up come first.
    """
    clock = best_clock()
    seconds: dict[bool, list[float]] = {False: [], True: []}
    for number in range(WARM_UP + pairs):
        for is_full in (True, False) if number % 2 else (False, True):
            start = clock()
            (full if is_full else plain)(number)
            if number >= WARM_UP:
                seconds[is_full].append(clock() - start)
    return PairedTimes(tuple(seconds[False]), tuple(seconds[True]))


def time_skies(pairs: int, size: FrameSize | None = None) -> PairedTimes:
    """Time the full sky with Moon against airglow and city light alone."""
    frame = size or FrameSize()

    def maker(sky: str) -> Callable[[int], None]:
        return lambda number: make_frame(moonlit(frame, sky, number), 0)

    return time_pairs(maker(PLAIN_SKY), maker(FULL_SKY), pairs)


def time_cameras(pairs: int, size: FrameSize | None = None) -> PairedTimes:
    """Time all of the camera's effects against a plain camera, for frames of a data set."""
    frame = size or FrameSize()
    plain, full = (data_set(frame, WARM_UP + pairs, full_camera) for full_camera in (False, True))
    return time_pairs(lambda number: make_frame(plain, number), lambda number: make_frame(full, number), pairs)


def time_everything(pairs: int, size: FrameSize | None = None) -> PairedTimes:
    """Time frames with everything at once against those of the plain data set."""
    frame = size or FrameSize()
    plain, full = data_set(frame, WARM_UP + pairs), everything(frame, WARM_UP + pairs)
    return time_pairs(lambda number: make_frame(plain, number), lambda number: make_frame(full, number), pairs)
