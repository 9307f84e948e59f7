"""Choices that several commands offer."""

from enum import StrEnum


class DetectionsChoice(StrEnum):
    """Whose detections solvers use."""

    OWN = "own"
    SHARED = "shared"
