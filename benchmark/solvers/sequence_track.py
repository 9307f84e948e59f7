"""Fusion of the fixes of a sequence's frames in one filter (`celnav.Track`), as a user of celnav would do it.

Because the camera turns, the filter can separate the error of the vertical that is constant in the camera from the position.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.protocol import Answer, Observation


@dataclass
class SequenceTrack:
    """What the frames of one sequence have shown so far; the first frame of another sequence starts anew."""

    _sequence: str | None = None
    _track: celnav.Track | None = None
    _confidences: list[float | None] = field(default_factory=list)  # of all fixes so far

    def answer(self, alone: Answer, fix: celnav.Fix, observation: Observation) -> Answer:
        """Take in a frame's fix or refusal, and answer for the frame.

        Parameters
        ----------
        alone : Answer
            Answer from the frame alone.
        fix : celnav.Fix
            The same as a fix; its covariance does not include the constant error of the vertical (`without_bias`).
        observation : Observation
            Observation of a frame of a sequence.

        Returns
        -------
        Answer
            The position of the track. Its confidence is the highest of the fixes that the track consists of.
        """
        place = observation.sequence
        assert place is not None
        if self._track is None or place.sequence_id != self._sequence or place.index == 0:
            self._sequence, self._track = place.sequence_id, celnav.Track(_standing(place.tilt_bias_sigma_deg))
            self._confidences = []
        if self._track.update(fix, observation.utc, image_heading_deg(observation.R_cam)) is not None:
            self._confidences.append(alone.confidence)
        points = self._track.points
        if not points:
            return alone
        used = zip(points, self._confidences[-len(points) :], strict=True)
        return dataclasses.replace(
            alone,
            ok=True,
            reason="",
            lat_deg=points[-1].lat_deg,
            lon_deg=points[-1].lon_deg,
            cov_km2=points[-1].cov_km2,
            confidence=max((known for point, known in used if point.used and known is not None), default=None),
        )


def without_bias(observation: Observation) -> Observation:
    """The observation with the standard deviation of its vertical reduced by the part that is constant in the camera."""
    place = observation.sequence
    assert place is not None
    left = observation.tilt_sigma_deg**2 - place.tilt_bias_sigma_deg**2
    return dataclasses.replace(observation, tilt_sigma_deg=math.sqrt(max(left, 0.0)))


def image_heading_deg(R_cam: NDArray[np.float64]) -> float:
    """Azimuth of the image's upward direction, deg: the heading of anything that turns with the camera."""
    return math.degrees(math.atan2(-R_cam[1, 0], -R_cam[1, 1]))


def _standing(tilt_bias_sigma_deg: float) -> celnav.TrackConfig:
    """Configuration of a filter for a fixed place and a mount with constant tilt."""
    return celnav.TrackConfig(
        speed_sigma_km_s=0.0,
        acceleration_km_s2=0.0,
        tilt_bias_sigma_deg=tilt_bias_sigma_deg,
        heading_bias_sigma_deg=0.0,
        bias_walk_deg=0.0,
    )
