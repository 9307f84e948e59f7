"""Choices that several commands offer."""

from enum import StrEnum


class DetectionsChoice(StrEnum):
    """Who detects."""

    OWN = "own"
    SHARED = "shared"
