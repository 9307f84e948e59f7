"""Tables 1.1 and 1.2 and the numbers behind figures 5 and 6, each next to the thesis' own."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.stats.intervals import Estimate, proportion, quantile_estimate, wilson
from benchmark.studies.common.page_model import Cell, Number, Table
from benchmark.studies.common.records import Rows
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis.rendered import PART, Depth

# Depth at which the literal reading on centroids is compared with Table 1.1: where its baseline comes closest to the thesis'
# 39 %. It was chosen after inspecting the curve, which the page states.
CENTROIDS = "centroids"


def of_200(percent_of: float) -> Number:
    """A recall of the thesis with Wilson's interval for its 200 frames."""
    low, high = wilson(percent_of / 100 * thesis.N_FRAMES, thesis.N_FRAMES)
    return Number(Estimate(percent_of / 100, low, high, thesis.N_FRAMES), "percent")


def closest_depth(rows: Rows, depths: Sequence[float]) -> float:
    """Return the depth at which the literal baseline's recall on centroids is nearest to the thesis' at magnitude 7."""
    aim = thesis.TABLE_1_1[0].recall / 100
    recalls = [rows.of(CENTROIDS, who.LITERAL_BASELINE, (depth,)).recall().value for depth in depths]
    return depths[int(np.argmin([abs(recall - aim) for recall in recalls]))]


def table_1_1(rows: Rows, depths: Sequence[float]) -> Table:
    """Table 1.1: the ablation at magnitude 7."""
    depth = closest_depth(rows, depths)
    body: list[tuple[Cell, ...]] = []
    published = [*thesis.TABLE_1_1, None]
    names = ("Baseline", "Baseline + SI", "Baseline + SI + PR", "Adaptive", "Catalogue selection alone")
    for name, given, ours, literal in zip(names, published, who.OURS_IN_TABLE, who.LITERAL_IN_TABLE, strict=True):
        here = rows.of(PART, ours, (thesis.TABLE_LABEL_MAG,))
        letter = rows.of(PART, literal, (thesis.TABLE_LABEL_MAG,))
        centroids = rows.of(CENTROIDS, literal, (depth,))
        body.append(
            (
                name,
                of_200(given.recall) if given else "not run",
                f"{given.median_km:.2f} km, {given.time_s:.2f} s" if given else "—",
                Number(here.recall(), "percent"),
                Number(here.median_km()),
                Number(here.median_solve_ms()),
                Number(letter.recall(), "percent"),
                Number(centroids.recall(), "percent"),
                Number(centroids.median_km()),
            )
        )
    n, m = len(rows.of(PART, who.BASELINE, (thesis.TABLE_LABEL_MAG,))), len(rows.of(CENTROIDS, who.BASELINE, (depth,)))
    return Table(
        "Table 1.1: ablation at limiting magnitude 7",
        f"{n} rendered frames; last two columns {m} centroid frames",
        (
            "configuration",
            "thesis: recall",
            "thesis: median error, time",
            "our reading: recall",
            "our reading: median km",
            "our reading: ms",
            "to the letter: recall",
            f"to the letter, centroids to mag {depth:g}: recall",
            f"to the letter, centroids to mag {depth:g}: median km",
        ),
        tuple(body),
        "Recall is the share of frames with an error below 10 km. Medians are over all frames, ∞ where half or more are "
        "refused. Times are of solving, without detection. The thesis' intervals are Wilson's for its 200 frames. The depth "
        "of the centroid columns was chosen after looking: it is where the literal baseline comes nearest to 39 %.",
    )


def confidence_bins(
    confidence: NDArray[np.float64], failed: NDArray[np.bool_], errors_km: NDArray[np.float64]
) -> list[tuple[int, Estimate, Estimate]]:
    """Count, median error and failure rate in the bins of Table 1.2.

    Parameters
    ----------
    confidence, errors_km : ndarray, shape (n,)
    failed : ndarray of bool, shape (n,)
    """
    found = []
    for row in thesis.TABLE_1_2:
        inside = (confidence >= row.low) & (confidence < row.high)
        found.append((int(inside.sum()), quantile_estimate(errors_km[inside], 0.5), proportion(failed[inside])))
    return found


def table_1_2(rows: Rows) -> Table:
    """Table 1.2: error and failures by confidence, over frames with a fix."""
    pictures = rows.of(PART, who.ADAPTIVE).rows
    letter = rows.of(CENTROIDS, who.LITERAL_ADAPTIVE).rows
    columns = []
    for part in (pictures, letter):
        kept = Rows(tuple(row for row in part if row.status == "fix"))
        columns.append(confidence_bins(kept.confidence, ~kept.near, kept.errors_km))
    body: list[tuple[Cell, ...]] = []
    for given, ours, literal in zip(thesis.TABLE_1_2, *columns, strict=True):
        low, high = wilson(round(given.failures / 100 * given.count), given.count)
        high_text = "" if given.high > 1 else f"–{given.high:.2f}"
        cells: list[Cell] = [f"{given.low:.2f}{high_text or ' and more'}", str(given.count), f"{given.median_km:,.2f}"]
        cells.append(Number(Estimate(given.failures / 100, low, high, given.count), "percent"))
        for count, median, failures in (ours, literal):
            cells += [str(count), Number(median), Number(failures, "percent")]
        body.append(tuple(cells))
    return Table(
        "Table 1.2: error and failures by confidence",
        f"{len(pictures)} rendered frames of all labels; {len(letter)} centroid frames of all depths",
        (
            "confidence",
            "thesis: frames",
            "thesis: median km",
            "thesis: failures",
            "our adaptive: frames",
            "median km",
            "failures",
            "literal adaptive, centroids: frames",
            "median km",
            "failures",
        ),
        tuple(body),
        "Frames with a fix only; a failure is an error of 10 km or more. Our adaptive variant refuses below 0.45.",
    )


def table_labels(rows: Rows, depths: Sequence[Depth]) -> Table:
    """Depth of each label's frames, with the recalls of figure 5."""
    body: list[tuple[Cell, ...]] = []
    for depth in depths:
        place = thesis.LABELS_MAG.index(depth.label_mag) if depth.label_mag in thesis.LABELS_MAG else None
        body.append(
            (
                f"{depth.label_mag:g}",
                "—" if math.isnan(depth.half_mag) else f"{depth.half_mag:.2f}",
                f"{depth.detections:.0f}",
                "—" if place is None else of_200(thesis.BASELINE_RECALL[place]),
                Number(rows.of(PART, who.BASELINE, (depth.label_mag,)).recall(), "percent"),
                "—" if place is None else of_200(thesis.ADAPTIVE_RECALL[place]),
                Number(rows.of(PART, who.ADAPTIVE, (depth.label_mag,)).recall(), "percent"),
                Number(rows.of(PART, who.BRIGHTEST_N, (depth.label_mag,)).recall(), "percent"),
                str(depth.n_frames),
            )
        )
    return Table(
        "Figure 5 in numbers, and the depth of each set",
        "rendered frames",
        (
            "label, mag",
            "half of the stars detected to, mag",
            "detections a frame",
            "baseline: thesis",
            "baseline: ours",
            "adaptive: thesis",
            "adaptive: ours",
            "brightest-n",
            "frames",
        ),
        tuple(body),
        "Detected: a detection within 1.5 px. Bins of 0.25 mag.",
    )


def table_depths(rows: Rows, depths: Sequence[float]) -> Table:
    """Recall against the depth of the frame, on centroids."""
    names = (who.LITERAL_BASELINE, who.LITERAL_ADAPTIVE, who.BASELINE, who.ADAPTIVE, who.DAI, who.BRIGHTEST_N)
    body: tuple[tuple[Cell, ...], ...] = tuple(
        (f"{depth:g}", *(Number(rows.of(CENTROIDS, name, (depth,)).recall(), "percent") for name in names))
        for depth in depths
    )
    n = len(rows.of(CENTROIDS, who.BASELINE, (depths[0],)))
    return Table(
        "Recall against the depth of the frame",
        f"{n} centroid frames a row, 0.3 px of noise, the same sites in every row",
        ("faintest star, mag", *names),
        body,
    )


def table_speed(rows: Rows) -> Table:
    """Times of solving on pictures."""
    names = [contestant.name for contestant in (*who.registered(), *who.literal())]
    body = tuple(
        (
            name,
            Number(rows.of(PART, name).median_solve_ms()),
            Number(rows.of(PART, name).p95_solve_ms()),
            Number(rows.of(PART, name).recall(), "percent"),
        )
        for name in names
    )
    return Table(
        "Time of solving",
        f"{len(rows.of(PART, names[0]))} rendered frames of all labels, one process",
        ("variant", "median ms", "95 % quantile ms", "recall"),
        body,
        "Refused frames included. Detection comes to these times and is the same for all.",
    )
