"""A session that passes its answers to the frames of a sequence through one filter (`benchmark.solvers.fusion`)."""

from __future__ import annotations

import dataclasses
import time

from benchmark.frames.dataset import Frame
from benchmark.judge.answers import Response
from benchmark.protocol import Detections
from benchmark.run.sessions import Session
from benchmark.solvers.fusion import Fusion, as_by_itself
from benchmark.stats.metrics import ERROR, FIX, REFUSED


class FusedSession:
    """Asks another session about each frame separately; the frames of a sequence must come in order.

    A frame on which the solver fails remains an error: the frames before do not hide it, and the following ones use them.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._fusion = Fusion()

    def start(self) -> str:
        """Start the solver. Raises SolverError."""
        return self._session.start()

    def answer(self, frame: Frame, shared: Detections | None) -> Response:
        """Ask the solver, then answer from all frames of the sequence so far; the filter's time is added to the solver's."""
        alone = self._session.answer(dataclasses.replace(frame, observation=as_by_itself(frame.observation)), shared)
        started = time.perf_counter()
        answer = self._fusion.answer(alone.answer, frame.observation)
        if alone.status == ERROR:
            return alone
        return dataclasses.replace(
            alone,
            answer=answer,
            status=FIX if answer.ok else REFUSED,
            solve_ms=alone.solve_ms + 1000.0 * (time.perf_counter() - started),
        )

    def close(self) -> None:
        """End the solver."""
        self._session.close()
