"""Contestants of a study: a solver of celnav with the study's own choices, on prepared detections."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.frames.dataset import Frame
from benchmark.judge.answers import judge_answer
from benchmark.judge.frame_bounds import bound_of
from benchmark.judge.outcome import SolverOutcome
from benchmark.protocol import Answer, Detections, Observation
from benchmark.provenance import distribution_version
from benchmark.run.sessions import ask
from benchmark.solvers.celnav_solver import answer_of
from celnav.problem import Solver


@dataclass(frozen=True, eq=False)
class Contestant:
    """A solver with its name in the study.

    Attributes
    ----------
    name : str
    solver : Solver
        One of celnav's solvers.
    history : celnav.History or None
        Carried from frame to frame if supplied.
    """

    name: str
    solver: Solver
    history: celnav.History | None = None


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A contestant that receives detections instead of an image."""

    contestant: Contestant
    found: celnav.Detections

    @property
    def name(self) -> str:
        return self.contestant.name

    @property
    def version(self) -> str:
        return distribution_version()

    @property
    def detector(self) -> str:
        return "prepared"

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        found: Detections = self.found
        return found

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        camera = celnav.Camera.from_dict(dataclasses.asdict(observation.camera))
        return answer_of(
            celnav.solve(
                self.found,
                camera,
                utc=observation.utc,
                attitude=observation.R_cam,
                solver=self.contestant.solver,
                history=self.contestant.history,
            )
        )


def judge_detections(
    frame: Frame, detections: celnav.Detections, contestants: Sequence[Contestant], warm_up: bool = False
) -> tuple[SolverOutcome, ...]:
    """Judge contestants on supplied detections with the benchmark's own judge.

    Parameters
    ----------
    frame : Frame
        Frame with its truth.
    detections : celnav.Detections
        Supplied to all contestants.
    contestants : sequence of Contestant
    warm_up : bool
        Whether to solve once untimed beforehand. Contestants with a history are not warmed up, since the history would learn
        from the frame.
    """
    prepared = [_Prepared(contestant, detections) for contestant in contestants]
    no_image = np.zeros((1, 1), dtype=np.uint16)
    if warm_up:
        for one in prepared:
            if one.contestant.history is None:
                ask(one, frame, no_image)
    bound_km = bound_of(frame)
    return tuple(judge_answer(frame, ask(one, frame, no_image), bound_km) for one in prepared)
