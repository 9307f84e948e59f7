"""Interface common to all export formats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from generator.dataset.reader import Dataset
from generator.errors import GeneratorError
from generator.frame.record import VISIBLE_SNR

Progress = Callable[[str], None]
"""Called with the id of each finished frame."""


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export.

    Attributes
    ----------
    least_snr : float or None
        Sources with at least this SNR are annotated; None annotates those that count as visible. Formats without
        annotations accept only None.
    """

    least_snr: float | None = None

    def __post_init__(self) -> None:
        """Refuse invalid options. Raises GeneratorError."""
        if self.least_snr is not None and not 0 <= self.least_snr < float("inf"):
            raise GeneratorError(f"--least-snr {self.least_snr}: 0 or more")

    @property
    def annotated_snr(self) -> float:
        """Least SNR of annotated sources."""
        return VISIBLE_SNR if self.least_snr is None else self.least_snr


Form = Callable[[Dataset, Path, ExportOptions, Progress], None]
"""Writes a dataset into a folder."""
