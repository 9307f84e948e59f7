"""The bound of the identification's effort: counted work and, where the caller wants one, a deadline.

The unit of work is one look-up: one detection laid on the star map under one hypothesis. Other steps count as many
look-ups as take the same processor time, so that a bound on work bounds the time of any input, while the count itself,
and so the answer, is the same on every machine.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

# In look-ups, which take 7 ns on one core of an idle AMD EPYC. A hypothesis is a pair of detections laid on a pair of
# stars, or one detection on one star. Batches, polishing and verification are mostly a fixed number of short array
# operations.
HYPOTHESIS_WORK = 16
# One of a pair of stars that the last known position excludes before it becomes a hypothesis.
PASSED_OVER_WORK = 4
BATCH_WORK = 20_000
POLISH_WORK = 12_000
VERIFICATION_WORK = 60_000
# A pair of a detection and a star that verification compares.
VERIFIED_PAIR_WORK = 1


@dataclass
class Effort:
    """The budget of a search and its expenses.

    Attributes
    ----------
    max_work : int
        Bound on `work`; `work` never exceeds it.
    deadline_s : float
        Value of `time.perf_counter` after which no further batch is begun; infinite without a deadline.
    limit : int
        Bound on `work` for the part of the search that is under way, at most `max_work`.
    work : int
        Spent so far, in look-ups.
    hypotheses : int
        Looked at so far: the bound of chance counts them.
    best_log10_false_alarm : float
        Of the best hypothesis verified so far.
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
        """Tell whether `work` more may be spent; a refusal is remembered."""
        if self.work + work <= self.limit and (math.isinf(self.deadline_s) or time.perf_counter() < self.deadline_s):
            return True
        self.spent = True
        return False
