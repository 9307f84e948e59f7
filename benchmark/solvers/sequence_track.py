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
from benchmark.protocol import Answer, Observation, SequencePlace


@dataclass
class _Hypothesis:
    """Fixes that agree, and the highest confidence among them."""

    track: celnav.Track
    fixes: int = 0
    confidence: float | None = None


@dataclass
class SequenceTrack:
    """What the frames of one sequence have shown so far; the first frame of another sequence starts anew.

    Fixes that disagree form separate hypotheses, and the hypothesis with the most fixes gives the answer. Otherwise a single
    misidentified first frame would block all that follow.
    """

    _sequence: str | None = None
    _hypotheses: list[_Hypothesis] = field(default_factory=list)

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
        """
        place = observation.sequence
        assert place is not None
        if place.sequence_id != self._sequence or place.index == 0:
            self._sequence, self._hypotheses = place.sequence_id, []
        if fix.ok:
            self._take(fix, alone.confidence, observation, place)
        if not self._hypotheses:
            return alone
        best = max(self._hypotheses, key=lambda one: one.fixes)  # among equals, the older one
        point = best.track.points[-1]
        return dataclasses.replace(
            alone,
            ok=True,
            reason="",
            lat_deg=point.lat_deg,
            lon_deg=point.lon_deg,
            cov_km2=point.cov_km2,
            confidence=best.confidence,
        )

    def _take(self, fix: celnav.Fix, confidence: float | None, observation: Observation, place: SequencePlace) -> None:
        heading = image_heading_deg(observation.R_cam)
        for one in sorted(self._hypotheses, key=lambda one: -one.fixes):
            point = one.track.update(fix, observation.utc, heading)
            if point is not None and point.used:
                break
        else:
            one = _Hypothesis(celnav.Track(_standing(place.tilt_bias_sigma_deg)))
            one.track.update(fix, observation.utc, heading)
            self._hypotheses.append(one)
        one.fixes += 1
        known = [value for value in (one.confidence, confidence) if value is not None]
        one.confidence = max(known, default=None)


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
