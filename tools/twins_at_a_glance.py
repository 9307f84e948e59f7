"""The bars of docs/realism.md, as `skybench twin` measured them: python tools/twins_at_a_glance.py out/twins.json 005 008.

The photographs named after the file are those of cloudless nights without the Moon, whose detections have a narrower bar. The
table has them first.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

BARS = (
    ("celnav's detections", "10 %; 25 % in moonlight or cloud"),
    ("sep's detections", "the same"),
    ("fraction of celnav's that is false", "factor 1.5"),
    ("fraction of sep's that is false", "factor 1.5"),
    ("sky brightness above 10 deg", "15 %"),
    ("noise: correlation of neighbours", "10 %"),
    ("noise: power by band", "10 %"),
    ("SNR of bright stars", "10 %"),
)


def farthest(ratios: Sequence[float]) -> float:
    """The ratio that is farthest from 1 by its logarithm."""
    return max(ratios, key=lambda ratio: abs(math.log(ratio)))


def false_ratio(found: dict[str, float]) -> float:
    """False fraction of the photograph's detections over that of the twin's, infinite where the twin has none."""
    real, twin = found["spurious_real"], found["spurious_twin"]
    return real / twin if twin else math.inf


def ratios(measures: dict[str, Any], is_dark: bool) -> list[tuple[float, bool]]:
    """Ratio of real to twin for each of `BARS`, at the worst altitude, direction or band, and whether it keeps its bar."""
    celnav, sep = measures["detections"]["celnav"], measures["detections"]["sep"]
    neighbours = zip(measures["autocorrelation_real"], measures["autocorrelation_twin"], strict=True)
    found = (
        celnav["real"] / celnav["twin"], sep["real"] / sep["twin"], false_ratio(celnav), false_ratio(sep),
        farthest(measures["sky_ratio"]), farthest([real / twin for real, twin in neighbours]),
        farthest(measures["spectrum_ratio"]), measures["snr_ratio"],
    )  # fmt: skip
    counts = (0.9, 1.1) if is_dark else (0.8, 1.25)
    ranges = (counts, counts, (1 / 1.5, 1.5), (1 / 1.5, 1.5), (0.85, 1.15), (0.9, 1.1), (0.9, 1.1), (0.9, 1.1))
    return [(ratio, low <= ratio <= high) for ratio, (low, high) in zip(found, ranges, strict=True)]


def row_of(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("measures", type=Path, help="twins.json, as `skybench twin` writes it")
    parser.add_argument("dark", nargs="*", help="photographs of cloudless nights without the Moon")
    given = parser.parse_args()
    twins = {one["photograph"]: one for one in json.loads(given.measures.read_text())["twins"]}
    names = sorted(twins, key=lambda name: (name not in given.dark, name))
    columns = [ratios(twins[name], name in given.dark) for name in names]
    print(row_of(["", "bar", *names]) + "\n" + row_of(["---"] * (2 + len(names))))
    for words, row in zip(BARS, zip(*columns, strict=True), strict=True):
        print(row_of([*words, *(f"{ratio:.2f}" if kept else f"**{ratio:.2f}**" for ratio, kept in row)]))
    counts = [sum(kept for _, kept in column) for column in columns]
    print(row_of(["kept", f"{sum(counts)} of {len(BARS) * len(names)}", *map(str, counts)]))


if __name__ == "__main__":
    main()
