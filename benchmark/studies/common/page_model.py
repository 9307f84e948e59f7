"""What a study's page is made of: numbers with intervals, tables, tests, answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from benchmark.report.formatting import interval, number, percent
from benchmark.stats.intervals import Estimate
from benchmark.stats.paired_tests import PairedTest, holm

Form = Literal["percent", "plain"]


@dataclass(frozen=True)
class Number:
    """An estimate and how it is printed."""

    estimate: Estimate
    form: Form = "plain"

    @property
    def text(self) -> str:
        """The value."""
        return percent(self.estimate.value) if self.form == "percent" else number(self.estimate.value)

    @property
    def range(self) -> str:
        """The 95 % interval."""
        return interval(self.estimate, percent if self.form == "percent" else number)


Cell = str | Number


@dataclass(frozen=True)
class Table:
    """A table; every number in it has an interval or says what it is."""

    title: str
    source: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class Comparison:
    """A paired test with its p-value adjusted among its family."""

    name: str
    test: PairedTest
    p_holm: float

    @property
    def text(self) -> str:
        """The test in words."""
        return (
            f"{self.name}: {self.test.only_first} to {self.test.only_second} of {self.test.n}, "
            f"p {p_text(self.test.p)}, after Holm {p_text(self.p_holm)}"
        )

    @property
    def first_is_better(self) -> bool:
        """The first succeeds more often, at 5 % after Holm."""
        return self.p_holm < 0.05 and self.test.only_first > self.test.only_second

    @property
    def second_is_better(self) -> bool:
        """The second succeeds more often, at 5 % after Holm."""
        return self.p_holm < 0.05 and self.test.only_second > self.test.only_first


def family(tests: Sequence[tuple[str, PairedTest]]) -> tuple[Comparison, ...]:
    """Adjust tests that belong together (Holm)."""
    adjusted = holm([test.p for _, test in tests])
    return tuple(Comparison(name, test, p) for (name, test), p in zip(tests, adjusted, strict=True))


def p_text(p: float) -> str:
    """Print a p-value with its sign of relation."""
    return "< 0.0001" if p < 1e-4 else f"= {p:.2g}"


@dataclass(frozen=True)
class Answer:
    """What the study says about a hypothesis.

    Attributes
    ----------
    key : str
        H1 to H11.
    claim : str
        The hypothesis.
    verdict : str
        A word or two, from the numbers.
    paragraphs : tuple of str
    tables : tuple of Table
    tests : tuple of Comparison
    """

    key: str
    claim: str
    verdict: str
    paragraphs: tuple[str, ...]
    tables: tuple[Table, ...] = ()
    tests: tuple[Comparison, ...] = field(default=())


def plain(value: object) -> Any:
    """Turn tables and answers into what JSON can hold: infinite and undefined numbers become None."""
    if isinstance(value, Number):
        e = value.estimate
        ends = {"value": e.value, "low": e.low, "high": e.high}
        return {k: v if math.isfinite(v) else None for k, v in ends.items()} | {"n": e.n, "unit": value.form}
    if isinstance(value, Table):
        return {
            "title": value.title,
            "source": value.source,
            "header": list(value.header),
            "rows": [[plain(cell) for cell in row] for row in value.rows],
            "note": value.note,
        }
    if isinstance(value, Comparison):
        test = value.test
        counts = {"n": test.n, "only_first": test.only_first, "only_second": test.only_second}
        return {"name": value.name, **counts, "p": test.p, "p_holm": value.p_holm}
    if isinstance(value, Answer):
        return {
            "key": value.key,
            "claim": value.claim,
            "verdict": value.verdict,
            "paragraphs": list(value.paragraphs),
            "tables": [plain(table) for table in value.tables],
            "tests": [plain(test) for test in value.tests],
        }
    return value
