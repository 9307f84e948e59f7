"""What every form of export gets to know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from generator.dataset.reader import Dataset
from generator.errors import GeneratorError
from generator.frame.record import VISIBLE_SNR

Progress = Callable[[str], None]
"""Called with the id of each frame that is done."""


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export.

    Attributes
    ----------
    least_snr : float
        Annotations (COCO, YOLO) are made of sources with this SNR or more.
    """

    least_snr: float = VISIBLE_SNR

    def __post_init__(self) -> None:
        """Refuse invalid options. Raises GeneratorError."""
        if not 0 <= self.least_snr < float("inf"):
            raise GeneratorError(f"--least-snr {self.least_snr}: 0 or more")


Form = Callable[[Dataset, Path, ExportOptions, Progress], None]
"""Writes a dataset into a folder."""
