"""The bound on the effort of an identification: counted work and, if the caller wants one, a deadline.

The unit of work is one look-up: one detection projected onto the star map under one hypothesis. Other steps count as many
look-ups as take the same processor time. A bound on work therefore bounds the time for any input, while the count itself,
and so the answer, is the same on every machine.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

# Work of the steps in look-ups, which take 7 ns on one core of an idle AMD EPYC. A hypothesis matches a pair of detections
# with a pair of stars, or one detection with one star. Batches, polishing and verification are mostly a fixed number of
# short array operations.
HYPOTHESIS_WORK = 16
# Work for a pair of stars that the last known position excludes before it becomes a hypothesis.
PASSED_OVER_WORK = 4
BATCH_WORK = 20_000
POLISH_WORK = 12_000
VERIFICATION_WORK = 60_000
# Work for each pair of a detection and a star that verification compares.
VERIFIED_PAIR_WORK = 1


@dataclass
class Effort:
    """The budget of a search and what has been spent of it.

    Attributes
    ----------
    max_work : int
        Bound on `work`; `work` never exceeds it.
    deadline_s : float
        Value of `time.perf_counter` after which no further batch is begun; infinite without a deadline.
    limit : int
        Bound on `work` for the current part of the search, at most `max_work`.
    work : int
        Work spent so far, in look-ups.
    hypotheses : int
        Number of hypotheses tried so far, which enters the false-alarm bound.
    best_log10_false_alarm : float
        False-alarm bound of the best hypothesis verified so far.
    spent : bool
        Whether a part of the search ended because it could not afford its next batch.
    """

    max_work: int
    deadline_s: float = math.inf
    limit: int = -1
    work: int = 0
    hypotheses: int = 0
    best_log10_false_alarm: float = 0.0
    spent: bool = False

    def __post_init__(self) -> None:
        if self.limit < 0:
            self.limit = self.max_work

    def allow(self, work: float) -> None:
        """Let the next part of the search spend at most `work`."""
        self.limit = min(self.max_work, self.work + int(work))

    def affords(self, work: int) -> bool:
        """Return whether `work` more may be spent; a refusal is recorded in `spent`."""
        if self.work + work <= self.limit and (math.isinf(self.deadline_s) or time.perf_counter() < self.deadline_s):
            return True
        self.spent = True
        return False
