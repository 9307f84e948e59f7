"""Progress reports of a study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Advance = Callable[[], None]
"""Takes no argument; reports that one more step is finished."""


@dataclass(frozen=True)
class StudyProgress:
    """Callbacks that a study uses while it runs.

    Attributes
    ----------
    begin : callable
        Called when a stage begins, with its name and its number of steps (0: unknown).
    advance : callable
        Called when a step of the stage is finished.
    """

    begin: Callable[[str, int], None]
    advance: Advance
