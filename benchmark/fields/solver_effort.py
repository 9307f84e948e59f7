"""Cost of refusals: work and processor time of the default solver on hostile inputs, relative to a calibration loop."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

import celnav
from benchmark.fields.hostile import KINDS, HostileInput, make_hostile

# Processor time on one core within which any input must be refused.
REFUSAL_S = 0.5


def calibration_s() -> float:
    """Processor time of a fixed loop of array operations like those of the solver, the least of five, seconds.

    It is some 6 ms on a core of 2025, 25 ms on older ones. Times divided by it are comparable between machines, and between
    busy and idle hours.
    """
    rng = np.random.default_rng(1)
    values = rng.random(20_000, dtype=np.float32) + 0.5
    rows = rng.integers(0, 20_000, 20_000)
    best = np.inf
    for _ in range(5):
        start = time.thread_time()
        for _ in range(200):
            scaled = values * np.float32(0.5) + values.take(rows)
            scaled /= np.abs(values) + np.float32(1)
            np.maximum(scaled, 0).sum()
        best = min(best, time.thread_time() - start)
    return float(best)


@dataclass(frozen=True)
class Refusal:
    """One hostile input and its cost.

    Attributes
    ----------
    question : HostileInput
        The input.
    reason : str
        Why it was refused; ``ok`` for a claimed position.
    work : int
        Look-ups (`celnav.Fix.work`).
    processor_s : float
        Processor time of this thread, seconds.
    """

    question: HostileInput
    reason: str
    work: int
    processor_s: float


@dataclass(frozen=True)
class EffortReport:
    """All refusals of a run.

    Attributes
    ----------
    refusals : tuple of Refusal
        One for each input.
    max_work : int
        The bound of the solver.
    loop_s : float
        Time of the calibration loop in the same run, seconds.
    """

    refusals: tuple[Refusal, ...]
    max_work: int
    loop_s: float

    @property
    def most_work(self) -> Refusal:
        """The input that took the most work."""
        return max(self.refusals, key=lambda each: each.work)

    @property
    def slowest(self) -> Refusal:
        """The input that took the most time."""
        return max(self.refusals, key=lambda each: each.processor_s)

    @property
    def claims(self) -> int:
        """Number of inputs that were answered with a position."""
        return sum(each.reason == "ok" for each in self.refusals)

    @property
    def passed(self) -> bool:
        """Whether the work kept to its bound, no input was answered, and none took too long."""
        in_bounds = self.most_work.work <= self.max_work and self.slowest.processor_s <= REFUSAL_S
        return in_bounds and self.claims == 0

    @property
    def reasons(self) -> dict[str, int]:
        """Number of inputs refused for each reason; ``ok`` counts claimed positions."""
        return dict(sorted(Counter(each.reason for each in self.refusals).items()))

    def document(self) -> dict[str, object]:
        """The content of the lines, as names and numbers."""
        most, slowest = self.most_work, self.slowest
        return {
            "inputs": len(self.refusals),
            "passed": self.passed,
            "claims": self.claims,
            "reasons": self.reasons,
            "max_work": self.max_work,
            "most_work": {"input": most.question.name, "reason": most.reason, "work": most.work},
            "slowest": {"input": slowest.question.name, "reason": slowest.reason, "processor_s": slowest.processor_s},
            "loop_s": self.loop_s,
        }

    def lines(self) -> Iterator[str]:
        """Yield the lines of a Markdown table and of the text below it."""
        yield "| hostile inputs | number | most work / bound | median s | worst s | worst / calibration loop |"
        yield "|-|-|-|-|-|-|"
        for kind in KINDS:
            mine = [each for each in self.refusals if each.question.kind == kind]
            if mine:
                yield self._row(kind, mine)
        yield self._row("all", list(self.refusals))
        yield ""
        yield f"calibration loop: {self.loop_s:.4f} s of processor time; bound of work: {self.max_work:,} look-ups"
        yield f"slowest: {self.slowest.question.name} ({self.slowest.reason})"
        yield f"most work: {self.most_work.question.name} ({self.most_work.reason})"
        yield f"reasons: {', '.join(f'{reason} {count}' for reason, count in self.reasons.items())}"
        yield (
            f"within the bound of work, without a claim, and each below {REFUSAL_S} s: {'yes' if self.passed else 'NO'}"
        )

    def _row(self, name: str, refusals: list[Refusal]) -> str:
        worst = max(each.processor_s for each in refusals)
        work = max(each.work for each in refusals) / self.max_work
        median = float(np.median([each.processor_s for each in refusals]))
        return f"| {name} | {len(refusals)} | {work:.2f} | {median:.3f} | {worst:.3f} | {worst / self.loop_s:.1f} |"


def measure_effort(n_inputs: int, seed: int, solver: celnav.SkybenchSolver | None = None) -> EffortReport:
    """Solve hostile inputs, and time a calibration loop before and after.

    Parameters
    ----------
    n_inputs : int
        Number of inputs.
    seed : int
        Seed of the inputs.
    solver : SkybenchSolver, optional
        By default, the default solver.
    """
    solver = celnav.SkybenchSolver() if solver is None else solver
    make_hostile(seed, 0).solve(solver)  # loads the tables
    loop_s = calibration_s()
    refusals = []
    for number in range(n_inputs):
        question = make_hostile(seed, number)
        start = time.thread_time()
        fix = question.solve(solver)
        elapsed = time.thread_time() - start
        refusals.append(Refusal(question, "ok" if fix.ok else str(fix.reason), fix.work, elapsed))
    return EffortReport(tuple(refusals), solver.config.max_work, min(loop_s, calibration_s()))


def report_effort(n_inputs: int, seed: int, echo: Callable[[str], None]) -> EffortReport:
    """Measure and print; return the measurements."""
    report = measure_effort(n_inputs, seed)
    for line in report.lines():
        echo(line)
    return report
