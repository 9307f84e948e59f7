"""Fusion of the positions of a sequence's frames in one filter, for a solver that answers each frame separately.

It is the filter of skybench's own answers (`benchmark.solvers.sequence_track`) and receives the same information about the
frames. A ``solver.yaml`` with `fuses` puts it behind any other solver.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.protocol import Answer, Observation
from benchmark.solvers.sequence_track import SequenceTrack, without_bias
from benchmark.solvers.told_errors import covariance_of_told

OWN_SIGMA_KM = 3.0
"""Standard deviation, east and north each, of a position whose solver states no covariance, in addition to errors from the
supplied vertical and time; docs/rivals.md reports the trials."""


def as_by_itself(observation: Observation) -> Observation:
    """Hide the sequence of a frame from the solver.

    The vertical's standard deviation that remains is that of the error which is new in each frame.
    """
    if observation.sequence is None:
        return observation
    return dataclasses.replace(without_bias(observation), sequence=None)


class Fusion:
    """The filter for one session of a solver."""

    def __init__(self) -> None:
        self._track = SequenceTrack()

    def answer(self, alone: Answer, observation: Observation) -> Answer:
        """Take in the solver's answer to a frame, and answer from the sequence so far.

        Parameters
        ----------
        alone : Answer
            Answer to the frame as `as_by_itself` presents it; one that `benchmark.judge.answers.check_answer` accepts.
        observation : Observation
            The frame as supplied; for a frame outside a sequence the solver's own answer is returned.
        """
        if observation.sequence is None:
            return alone
        return self._track.answer(alone, _fix_of(alone, as_by_itself(observation)), observation)


def _fix_of(alone: Answer, told: Observation) -> celnav.Fix:
    """Convert an answer to celnav's terms."""
    if alone.lat_deg is None or alone.lon_deg is None:
        return celnav.Fix.refusal(celnav.Reason.NO_HYPOTHESIS, alone.reason)
    cov_km2 = alone.cov_km2
    if cov_km2 is None or not _is_covariance(cov_km2):
        cov_km2 = covariance_of_told(alone.lat_deg, told) + OWN_SIGMA_KM**2 * np.eye(2)
    return celnav.Fix(True, celnav.Reason.OK, lat_deg=alone.lat_deg, lon_deg=alone.lon_deg, cov_km2=cov_km2)


def _is_covariance(matrix: NDArray[np.float64]) -> bool:
    """Whether a symmetric matrix is a valid covariance with errors in all directions."""
    return bool(np.linalg.eigvalsh(matrix).min() > 0.0)
