"""Solvers whose searches end by the clock, and how much of a request's time a search may take."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from benchmark.protocol import SolverUnderTest


@runtime_checkable
class TimeLimited(Protocol):
    """A contestant that is told, before each frame, what it may take."""

    def within(self, time_limit_s: float) -> SolverUnderTest:
        """The same solver, with a clock that starts now and ends after so many seconds."""
