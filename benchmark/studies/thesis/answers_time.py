"""The answer about the time of solving, H11, and whether the target speeds are reached."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from benchmark.studies.common.page_model import Answer, Verdict
from benchmark.studies.common.records import Rows
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis.hypotheses import CLAIMS
from benchmark.studies.thesis.rendered import PART

SPEED_LIMITS_MS = MappingProxyType({who.ADAPTIVE: 50.0, who.BASELINE_SI: 100.0})


@dataclass(frozen=True)
class Speed:
    """A variant's median time of solving, and the target time."""

    name: str
    median_ms: float
    limit_ms: float

    @property
    def reached(self) -> bool:
        """Whether it is within the target time."""
        return self.median_ms <= self.limit_ms


@dataclass(frozen=True)
class Ranking:
    """H11: configurations of Table 1.1 from the fastest to the slowest.

    Attributes
    ----------
    thesis, ours, literal : tuple of str
    thesis_factor, our_factor, literal_factor : float
        Time with iteration over time without.
    """

    thesis: tuple[str, ...]
    ours: tuple[str, ...]
    literal: tuple[str, ...]
    thesis_factor: float
    our_factor: float
    literal_factor: float


def speeds(rows: Rows) -> tuple[Speed, ...]:
    """Compare median times on all rendered frames with the target times."""
    return tuple(Speed(name, rows.of(PART, name).median_solve_ms().value, ms) for name, ms in SPEED_LIMITS_MS.items())


def h11(rows: Rows) -> Answer:
    """Whether the ranking by time holds."""
    given = [row.time_s for row in thesis.TABLE_1_1]
    names = [row.name for row in thesis.TABLE_1_1]

    def times(variants: tuple[str, ...]) -> list[float]:
        found = [rows.of(PART, name, (thesis.TABLE_LABEL_MAG,)) for name in variants[: len(given)]]
        return [one.median_solve_ms().value for one in found]

    def ranking(found: list[float]) -> tuple[str, ...]:
        return tuple(names[int(place)] for place in np.argsort(found))

    ours, letter = times(who.OURS_IN_TABLE), times(who.LITERAL_IN_TABLE)
    same = [ranking(found) == ranking(given) for found in (ours, letter)]
    verdict = Verdict.YES if all(same) else Verdict.IN_PART if any(same) else Verdict.NO
    return Answer(
        "H11",
        CLAIMS["H11"],
        (("", verdict),),
        Ranking(
            ranking(given),
            ranking(ours),
            ranking(letter),
            given[1] / given[0],
            ours[1] / ours[0],
            letter[1] / letter[0],
        ),
    )
