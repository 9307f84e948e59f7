"""Building blocks of a study's page: numbers with intervals, tables, tests, answers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal

from benchmark.report.formatting import interval, number, percent
from benchmark.stats.intervals import Estimate
from benchmark.stats.paired_tests import PairedTest, holm

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Form = Literal["percent", "plain"]
SIGNIFICANCE = 0.05


class Verdict(StrEnum):
    """Whether a hypothesis holds."""

    YES = "yes"
    NO = "no"
    APPROXIMATELY = "approximately"
    IN_PART = "in part"
    FOR_SOME = "for some"
    POSSIBLE = "possible"
    NOT_SHOWN = "not shown"


class Outcome(StrEnum):
    """How the first of two compared solvers does against the second."""

    BETTER = "better"
    WORSE = "worse"
    NO_DIFFERENCE = "no difference found"


@dataclass(frozen=True)
class Number:
    """An estimate and the format in which it is printed."""

    estimate: Estimate
    form: Form = "plain"

    @property
    def text(self) -> str:
        """The formatted value."""
        return percent(self.estimate.value) if self.form == "percent" else number(self.estimate.value)

    @property
    def range(self) -> str:
        """The formatted 95 % interval."""
        return interval(self.estimate, percent if self.form == "percent" else number)


Cell = str | Number


@dataclass(frozen=True)
class Table:
    """A table; cells that are estimates come with their intervals."""

    title: str
    source: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """A paired test, with its p-value adjusted within its family."""

    name: str
    test: PairedTest
    p_holm: float

    @property
    def text(self) -> str:
        """Describe the test in words."""
        return (
            f"{self.name}: {self.test.only_first} to {self.test.only_second} of {self.test.n}, "
            f"p {p_text(self.test.p)}, after Holm {p_text(self.p_holm)}"
        )

    @property
    def outcome(self) -> Outcome:
        """How the first does against the second, at 5 % after Holm's adjustment."""
        if self.p_holm >= SIGNIFICANCE or self.test.only_first == self.test.only_second:
            return Outcome.NO_DIFFERENCE
        return Outcome.BETTER if self.test.only_first > self.test.only_second else Outcome.WORSE


def family(tests: Sequence[tuple[str, PairedTest]]) -> tuple[Comparison, ...]:
    """Adjust the p-values of tests that belong together (Holm)."""
    adjusted = holm([test.p for _, test in tests])
    return tuple(Comparison(name, test, p) for (name, test), p in zip(tests, adjusted, strict=True))


def p_text(p: float) -> str:
    """Format a p-value with its sign of relation."""
    return "< 0.0001" if p < 1e-4 else f"= {p:.2g}"


@dataclass(frozen=True)
class Answer:
    """A study's answer to a hypothesis.

    Attributes
    ----------
    key : str
        Key of the hypothesis; names the template that puts the finding into words.
    claim : str
        The hypothesis.
    verdicts : tuple of (str, Verdict or Outcome)
        Verdicts with their aspects; an aspect is empty where there is only one.
    finding : dataclass instance
        The numbers and findings from which the words are composed.
    tables : tuple of Table
    tests : tuple of Comparison
    """

    key: str
    claim: str
    verdicts: tuple[tuple[str, Verdict | Outcome], ...]
    finding: DataclassInstance
    tables: tuple[Table, ...] = ()
    tests: tuple[Comparison, ...] = ()

    @property
    def verdict(self) -> str:
        """Format the verdicts in one line: ``yes``, ``as a limit: not shown; as a weight: yes``."""
        return "; ".join(f"{aspect}: {verdict}" if aspect else str(verdict) for aspect, verdict in self.verdicts)


def plain(value: object) -> Any:
    """Convert tables, answers and other data classes to what JSON can hold: non-finite numbers become None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Number):
        return plain(value.estimate) | {"unit": value.form}
    if isinstance(value, Comparison):
        test = value.test
        counts = {"n": test.n, "only_first": test.only_first, "only_second": test.only_second}
        return {"name": value.name, **counts, "p": test.p, "p_holm": value.p_holm}
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value
