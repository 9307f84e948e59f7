"""The bars of docs/realism.md, from tables of `skybench twin`: python tools/twins_at_a_glance.py out/twins.md 005 008.

The photographs named after the file are those of cloudless nights without the Moon, whose detections have the narrower bar.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

Cells = Sequence[str]


@dataclass(frozen=True)
class Bar:
    """A measured ratio of real to twin and the range that it is to keep.

    Attributes
    ----------
    words : str
        First two cells of the row.
    ratio : callable
        The ratio, from a photograph's cells in each of the three tables.
    low, high : float
        The range, inclusive.
    dark : float
        Half-width of the range about 1 on dark, cloudless nights; that of `low` and `high` where it is not given.
    """

    words: str
    ratio: Callable[[Sequence[Cells]], float]
    low: float
    high: float
    dark: float | None = None

    def kept(self, ratio: float, is_dark: bool) -> bool:
        low, high = (1 - self.dark, 1 + self.dark) if is_dark and self.dark is not None else (self.low, self.high)
        return low - 1e-9 <= ratio <= high + 1e-9


def numbers(cell: str) -> list[float]:
    return [float(found) for found in re.findall(r"-?\d+(?:\.\d+)?", cell)]


def farthest(ratios: Sequence[float]) -> float:
    """The ratio that is farthest from 1 by its logarithm."""
    return max(ratios, key=lambda ratio: abs(math.log(max(ratio, 1e-3))))


def quotient(upper: Sequence[float], lower: Sequence[float]) -> float:
    return farthest([a / b for a, b in zip(upper, lower, strict=True)])


def detections(column: int) -> Callable[[Sequence[Cells]], float]:
    """Ratio of the counts in a column of the second table, such as "1795 / 1971 = 0.91"."""
    return lambda tables: numbers(tables[1][column])[0] / numbers(tables[1][column])[1]


def false(column: int) -> Callable[[Sequence[Cells]], float]:
    """Ratio of the percentages in two neighbouring columns of the second table; infinite where the twin has none."""

    def ratio(tables: Sequence[Cells]) -> float:
        real, twin = (numbers(tables[1][column + k])[0] for k in (0, 1))
        return real / twin if twin else math.inf if real else 1.0

    return ratio


BARS = (
    Bar("celnav's detections | 10 %; 25 % in moonlight or cloud", detections(1), 0.8, 1.25, 0.1),
    Bar("sep's detections | the same", detections(4), 0.8, 1.25, 0.1),
    Bar("fraction of celnav's that is false | factor 1.5", false(2), 1 / 1.5, 1.5),
    Bar("fraction of sep's that is false | factor 1.5", false(5), 1 / 1.5, 1.5),
    Bar("sky brightness above 10 deg | 15 %", lambda t: farthest([float(cell) for cell in t[0][9:15]]), 0.85, 1.15),
    Bar("noise: correlation of neighbours | 10 %", lambda t: quotient(numbers(t[2][1]), numbers(t[2][2])), 0.9, 1.1),
    Bar("noise: power by band | 10 %", lambda t: farthest(numbers(t[2][3])), 0.9, 1.1),
    Bar("SNR of bright stars | 10 %", lambda t: float(t[1][8]), 0.9, 1.1),
)


def read_tables(path: Path) -> dict[str, list[Cells]]:
    """Cells of each photograph, by table."""
    found: dict[str, list[Cells]] = {}
    for table in path.read_text().strip().split("\n\n")[:3]:
        for line in table.splitlines()[2:]:
            cells = [cell.strip() for cell in line.split("|")[1:-1]]
            found.setdefault(cells[0], []).append(cells)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", type=Path, help="twins.md, as `skybench twin` writes it")
    parser.add_argument("dark", nargs="*", help="photographs of cloudless nights without the Moon")
    given = parser.parse_args()
    tables = read_tables(given.tables)
    kept = dict.fromkeys(tables, 0)
    print("| | bar |" + "".join(f" {name} |" for name in tables) + "\n|" + " --- |" * (2 + len(tables)))
    for bar in BARS:
        cells = []
        for name, table in tables.items():
            ratio = bar.ratio(table)
            is_kept = bar.kept(ratio, name in given.dark)
            kept[name] += is_kept
            cells.append(f"{ratio:.2f}" if is_kept else f"**{ratio:.2f}**")
        print(f"| {bar.words} | " + " | ".join(cells) + " |")
    print("| kept | | " + " | ".join(str(count) for count in kept.values()) + " |")
    print(f"{sum(kept.values())} of {len(BARS) * len(tables)}")


if __name__ == "__main__":
    main()
