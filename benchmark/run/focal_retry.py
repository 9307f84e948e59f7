"""Retries of refused frames with other focal lengths, the same for all contestants that do not search by themselves.

The tries share the frame's time. Each receives its share of the remaining time, so that a search that the clock ends uses no
more than that and leaves some for the tries after it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

from benchmark.frames.dataset import Frame
from benchmark.protocol import Observation
from celnav.camera import Camera
from celnav.problem import ToldSigmas

FOCAL_FACTORS = (0.88, 1.13)
"""Factors on the supplied focal length, in order, where it is known to a few per cent."""
FIRST_SHARE = 0.6
"""Share of the frame's time for the supplied focal length, which is right most often; the others divide the rest."""


def focal_factors(told: Observation) -> tuple[float, ...]:
    """Factors on the supplied focal length to try after it, nearest first; celnav's default solver searches at the same.

    Where the supplied standard deviations of focal length and distortion leave it open by more than a few per cent, they
    cover three of these deviations.
    """
    sigmas = ToldSigmas(focal=min(told.focal_sigma, 1.0), distortion=min(told.distortion_sigma, 1.0))
    return sigmas.focal_factors(FOCAL_FACTORS, Camera.from_dict(dataclasses.asdict(told.camera)))


def shares(n_others: int) -> tuple[float, ...]:
    """Largest share of the remaining time for the supplied focal length and each of the others, in order."""
    if not n_others:
        return (1.0,)
    return (FIRST_SHARE, *(1.0 / (n_others - done) for done in range(n_others)))


def at_focal_lengths(frame: Frame, factors: Iterable[float]) -> Iterator[Frame]:
    """Yield the frame with other focal lengths."""
    told = frame.observation
    for factor in factors:
        camera = dataclasses.replace(told.camera, f_px=factor * told.camera.f_px, fy_px=factor * told.camera.fy_px)
        yield dataclasses.replace(frame, observation=dataclasses.replace(told, camera=camera))
