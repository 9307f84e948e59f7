"""The fixes of a sequence's frames in one filter (`celnav.Track`), as a user of celnav would take them.

It tells the error of the vertical that stands still in the camera from the place, because the camera turns.
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
    """What the frames of one sequence say so far; the first frame of another begins anew.

    Fixes that disagree make hypotheses of their own, and that of the most fixes answers: one misidentified frame, were it the
    first, would otherwise bar all that follow.
    """

    _sequence: str | None = None
    _hypotheses: list[_Hypothesis] = field(default_factory=list)

    def answer(self, alone: Answer, fix: celnav.Fix, observation: Observation) -> Answer:
        """Take in a frame's fix, or its refusal, and answer for the frame.

        Parameters
        ----------
        alone : Answer
            By the frame alone.
        fix : celnav.Fix
            The same; its covariance without the error of the vertical that stands still (`without_bias`).
        observation : Observation
            Of a sequence.
        """
        place = observation.sequence
        assert place is not None
        if place.sequence_id != self._sequence or place.index == 0:
            self._sequence, self._hypotheses = place.sequence_id, []
        if fix.ok:
            self._take(fix, alone.confidence, observation, place)
        if not self._hypotheses:
            return alone
        best = max(self._hypotheses, key=lambda one: one.fixes)  # of equals the older
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
    """What is told, the vertical's standard deviation without the part that stands still in the camera."""
    place = observation.sequence
    assert place is not None
    left = observation.tilt_sigma_deg**2 - place.tilt_bias_sigma_deg**2
    return dataclasses.replace(observation, tilt_sigma_deg=math.sqrt(max(left, 0.0)))


def image_heading_deg(R_cam: NDArray[np.float64]) -> float:
    """Azimuth of the image's upward direction, deg: the heading of what turns with the camera."""
    return math.degrees(math.atan2(-R_cam[1, 0], -R_cam[1, 1]))


def _standing(tilt_bias_sigma_deg: float) -> celnav.TrackConfig:
    """A filter for a place that stays, and a mount whose tilt stays."""
    return celnav.TrackConfig(
        speed_sigma_km_s=0.0,
        acceleration_km_s2=0.0,
        tilt_bias_sigma_deg=tilt_bias_sigma_deg,
        heading_bias_sigma_deg=0.0,
        bias_walk_deg=0.0,
    )
