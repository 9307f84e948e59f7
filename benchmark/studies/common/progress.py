"""How a study reports its progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Advance = Callable[[], None]
"""Takes no argument: one step more is finished."""


@dataclass(frozen=True)
class StudyProgress:
    """Called by a study while it runs.

    Attributes
    ----------
    begin : callable
        A stage begins: its name and its number of steps (0: unknown).
    advance : callable
        A step of the stage is finished.
    """

    begin: Callable[[str, int], None]
    advance: Advance
