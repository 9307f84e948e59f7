"""What a study tells its caller while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class StudyProgress:
    """What the caller wants to hear: a stage begins, with so many steps (0: unknown), and a step is done."""

    begin: Callable[[str, int], None]
    advance: Callable[[], None]
