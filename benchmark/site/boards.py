"""What the report shows, worked out and ready to draw: boards of entries, one board for each set of results compared.

A board holds the results of one task, split and mode of detections; all its solvers answered the same frames.
"""

from dataclasses import dataclass

from benchmark.intervals import Estimate
from benchmark.metrics import FrameScore


@dataclass(frozen=True)
class Condition:
    """What a task grades: its name, unit (may be empty) and whether larger values are harder."""

    name: str
    unit: str
    larger_is_harder: bool

    @property
    def title(self) -> str:
        """Name and unit, for an axis."""
        return f"{self.name}, {self.unit}" if self.unit else self.name


@dataclass(frozen=True)
class Level:
    """One solver at one value of the condition; `bound_km` is the median Cramér-Rao bound, NaN where there is none."""

    condition: float
    n_frames: int
    success: Estimate
    median_error_km: Estimate
    bound_km: float
