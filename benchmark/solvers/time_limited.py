"""Solvers whose searches end by the clock, and the part of a request's time that a search may take."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from benchmark.protocol import SolverUnderTest


@runtime_checkable
class TimeLimited(Protocol):
    """A solver that receives its time limit before each frame."""

    def within(self, time_limit_s: float) -> SolverUnderTest:
        """The same solver with a time limit that starts now."""
