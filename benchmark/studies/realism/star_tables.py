"""Tables of the realism study: stars' SNR by magnitude, and their width by the angle from the axis."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from benchmark.studies.common.page_model import Table
from benchmark.twin.star_bins import ANGLE_EDGES_DEG, LEAST_SNR, LEAST_STARS, MAGNITUDE_EDGES


def star_tables(measures: Sequence[Mapping[str, Any]]) -> tuple[Table, Table]:
    """Photograph over twin in bins, with the standard deviation of the ratio and the number of stars."""
    return (
        _table(
            "SNR by magnitude",
            "Photograph over twin: ratio of the median SNR of the stars in a bin of V, its standard deviation, and in "
            "parentheses the number of stars.",
            "V",
            MAGNITUDE_EDGES,
            [(one["photograph"], one["snr_by_magnitude"]) for one in measures],
        ),
        _table(
            "Width of stars by the angle from the axis",
            "Photograph over twin: ratio of the median width (root mean square along one axis, within 3.5 px) of stars with "
            f"an SNR of {LEAST_SNR:g} or more on both, its standard deviation, and in parentheses the photograph's width and "
            "the number of stars.",
            "deg",
            ANGLE_EDGES_DEG,
            [(one["photograph"], one["width_by_angle_px"]) for one in measures],
            "px",
        ),
    )


def _table(
    title: str,
    source: str,
    unit: str,
    edges: Sequence[float],
    rows: Sequence[tuple[str, Sequence[Mapping[str, Any]]]],
    shown: str = "",
) -> Table:
    bins = list(itertools.pairwise(edges))
    header = ("photograph", *(f"{low:g} to {high:g} {unit}" for low, high in bins))
    lines = []
    for name, found in rows:
        by_bin = {(one["low"], one["high"]): one for one in found}
        lines.append((name, *(_cell(by_bin.get(each), shown) for each in bins)))
    return Table(title, source, header, tuple(lines), f"A dash: fewer than {LEAST_STARS} stars.")


def _cell(one: Mapping[str, Any] | None, shown: str) -> str:
    if one is None or one["ratio"] is None:
        return "-"
    size = f"{one['real']:.2f} {shown}, " if shown else ""
    return f"{one['ratio']:.2f} ± {one['sigma']:.2f} ({size}{one['stars']})"
