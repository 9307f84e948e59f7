"""Stars of photographs and of their twins in bins: a table of ratios, and a figure of both for each pair."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmark.report.formatting import number
from benchmark.studies.common.page_model import Table
from benchmark.studies.common.series_plot import Axis, Series, plot
from benchmark.twin.report import SNR_BINS, WIDTH_BINS
from benchmark.twin.star_bins import ANGLES_DEG, LEAST_STARS, MAGNITUDES, WIDTH_SNR, StarBin, bins_of

NONE = "-"
ASIDE_PX = 4.0
"""Half the distance of the marks of a photograph and of its twin."""
SNR_ENDS = (1.0, 1000.0)
LEAST_WIDTH_PX = 1.0
"""Least end of the axis of widths."""
WIDTH_STEP_PX = 0.5


@dataclass(frozen=True)
class Pair:
    """Stars of a photograph and of its twin.

    Attributes
    ----------
    name : str
        Name of the photograph.
    snr, width : tuple of StarBin
        SNR by V; width, px, by the angle from the axis; empty without enough stars.
    """

    name: str
    snr: tuple[StarBin, ...]
    width: tuple[StarBin, ...]


@dataclass(frozen=True)
class Drawn:
    """A figure of the page: its title, its caption, and legend and drawing as HTML."""

    title: str
    note: str
    html: str


def pairs_of(measures: Sequence[Mapping[str, Any]]) -> tuple[Pair, ...]:
    """Stars in bins from the measurements on pairs (`benchmark.twin.report.numbers_of_twin`)."""
    return tuple(Pair(one["photograph"], bins_of(one[SNR_BINS]), bins_of(one[WIDTH_BINS])) for one in measures)


def star_tables(pairs: Sequence[Pair]) -> tuple[Table, ...]:
    """Ratios by bin, with intervals and numbers of stars; columns and tables are left out where no pair has stars in them."""
    about = (
        "Photograph over twin, its 95 % interval by a bootstrap over stars, and the number of stars; "
        f"{NONE} with fewer than {LEAST_STARS}."
    )
    tables = (
        _table(
            "SNR by magnitude",
            f"{about} Medians of stars without a neighbour, above 20 deg; undefined (—) where the twin shows none.",
            "V",
            MAGNITUDES,
            [(pair.name, pair.snr) for pair in pairs],
        ),
        _table(
            "Width of stars by the angle from the axis",
            f"{about} Medians of stars to V 6 without a neighbour, above 10 deg, with an SNR of {WIDTH_SNR:g} on both; the "
            "width is the standard deviation, px, of the Gaussian with the star's windowed moment.",
            "deg",
            ANGLES_DEG,
            [(pair.name, pair.width) for pair in pairs],
        ),
    )
    return tuple(table for table in tables if len(table.header) > 1)


def _table(
    title: str, source: str, unit: str, edges: Sequence[float], rows: Sequence[tuple[str, tuple[StarBin, ...]]]
) -> Table:
    lows = [low for low in edges if any(low == one.low for _, bins in rows for one in bins)]
    highs = dict(itertools.pairwise(edges))
    header = tuple(f"{unit} {'to' if low < 0 else f'{low:g} to'} {highs[low]:g}" for low in lows)
    return Table(
        title,
        source,
        ("photograph", *header),
        tuple(
            (name, *(next((_cell(one) for one in bins if one.low == low), NONE) for low in lows)) for name, bins in rows
        ),
    )


def _cell(one: StarBin) -> str:
    ratio = one.ratio
    if not math.isfinite(ratio.value):
        return f"{number(ratio.value)}, {ratio.n}"
    return f"{ratio.value:.2f} ({ratio.low:.2f} to {_end(ratio.high)}), {ratio.n}"


def _end(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else number(value)


def star_figures(pairs: Sequence[Pair]) -> tuple[Drawn, ...]:
    """Medians of every pair with their intervals, the photograph beside its twin; none where there are no stars."""
    found = []
    widest = max((end for pair in pairs for one in pair.width for end in (one.real.high, one.twin.high)), default=0.0)
    width_end = max(LEAST_WIDTH_PX, math.ceil(1.05 * widest / WIDTH_STEP_PX) * WIDTH_STEP_PX)
    farthest = max((one.high for pair in pairs for one in pair.width), default=ANGLES_DEG[1])
    for pair in pairs:
        if pair.snr:
            title = f"SNR, {pair.name}"
            x = Axis("V", 0.0, MAGNITUDES[-1], tuple((float(mag), f"{mag}") for mag in range(int(MAGNITUDES[-1]) + 1)))
            y = Axis("SNR", *SNR_ENDS, tuple((10.0**n, f"{10**n}") for n in range(4)), log=True)
            found.append(_drawn(title, pair.snr, x, y, "Medians by magnitude; those below 1 are drawn at 1."))
        if pair.width:
            title = f"Width of stars, {pair.name}"
            angles = tuple((deg, f"{deg:g}") for deg in ANGLES_DEG if deg <= farthest)
            x = Axis("angle from the axis, deg", 0.0, farthest, angles)
            steps = tuple(
                (n * WIDTH_STEP_PX, f"{n * WIDTH_STEP_PX:g}") for n in range(round(width_end / WIDTH_STEP_PX) + 1)
            )
            y = Axis("px", 0.0, width_end, steps)
            found.append(_drawn(title, pair.width, x, y, "Median standard deviations by the angle from the axis."))
    return tuple(found)


def _drawn(title: str, bins: Sequence[StarBin], x: Axis, y: Axis, note: str) -> Drawn:
    places = [one.middle for one in bins]
    series = [
        Series(
            name,
            places,
            [each.value for each in ends],
            [each.low for each in ends],
            [each.high for each in ends],
            shape=shape,
            filled=filled,
            line="none",
            shift_px=shift_px,
            colour=colour,
        )
        for name, ends, shape, filled, shift_px, colour in (
            ("photograph", [one.real for one in bins], "circle", True, -ASIDE_PX, 0),
            ("twin", [one.twin for one in bins], "square", False, ASIDE_PX, 1),
        )
    ]
    return Drawn(title, note, plot(series, x, y, f"{title}: photograph and twin; the ratios are in the table"))
