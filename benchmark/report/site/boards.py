"""Computed content of the report, ready to draw: boards of entries, one board for each set of compared results.

A board holds the results on one set of frames in one mode of detection; all its solvers answered the same frames.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmark.errors import ResultsError
from benchmark.frames.identity import UNKNOWN
from benchmark.report.formatting import number
from benchmark.report.site.tree import StoredResult, TaskFacts
from benchmark.run.identities import identities_in
from benchmark.stats.break_point import Discrimination, break_point, discrimination
from benchmark.stats.comparison import Comparison, Rank, compare, detectable, ranks
from benchmark.stats.confidence import (
    ReliabilityBin,
    RiskCoverage,
    confidence_metrics_within,
    reliability,
    risk_coverage,
)
from benchmark.stats.covariance import covariance_metrics_within
from benchmark.stats.frame_metrics import (
    METRICS,
    UNDEFINED,
    column,
    errors_km,
    fixed,
    groups_of,
    measure,
    metrics_within,
    succeeded,
    success_metric,
)
from benchmark.stats.intervals import Estimate
from benchmark.stats.metrics import ERROR, FIX, REFUSED
from benchmark.tasks.definition import MOST_VALUES

F8 = NDArray[np.float64]

_MOST_SHOWN = 9
"""Number of groups of frames by which success is shown where no task grades them: that of the Bortle classes."""
_NO_BREAK = Estimate(math.nan, math.nan, math.nan, 0)
_MOST_GROUPS = 4
_CIRCUMSTANCES = (
    ("bortle", "Bortle class", ""),
    ("zenith_mag_arcsec2", "zenith brightness", "mag/arcsec²"),
    ("moon_altitude_deg", "altitude of the Moon", "°"),
    ("cloud_optical_depth", "optical depth of cloud", ""),
    ("limiting_magnitude", "limiting magnitude", "mag"),
    ("rate_deg_s", "turning rate", "°/s"),
    ("exposure_s", "exposure", "s"),
    ("fov_deg", "field of view", "°"),
    ("altitude_deg", "altitude of the boresight", "°"),
    ("true_latitude_deg", "latitude", "°"),
)


@dataclass(frozen=True)
class Level:
    """One solver at one value of the condition; `bound_km` is the median Cramér-Rao bound, NaN where there is none."""

    condition: float
    n_frames: int
    success: Estimate
    median_error_km: Estimate
    bound_km: float


@dataclass(frozen=True)
class Circumstance:
    """A property of frames that varies but is not graded by their task: its name and the limits of its groups.

    Attributes
    ----------
    column, name, unit : str
        Column of the table of frames, and name and unit as printed.
    groups : tuple of (float, float)
        Smallest and largest value in each group of frames.
    """

    column: str
    name: str
    unit: str
    groups: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class WorstFrame:
    """The frame with a solver's worst failure: its farthest fix, or its refusal at the easiest condition."""

    frame_id: str
    condition: float
    words: str


@dataclass(frozen=True, eq=False)
class Entry:
    """One solver on a board.

    Attributes
    ----------
    stored : StoredResult
        The result from which it comes.
    metrics : mapping of str to Estimate
        All of `metrics_within`, `confidence_metrics_within` and `covariance_metrics_within` by key, with the task's limit.
        The area under the risk-coverage curve is undefined where no fix has a confidence.
    success : Estimate
        By the limit of the task's own metric.
    rank : Rank
    break_point : Estimate
        In the unit of the condition.
    levels : tuple of Level
        In ascending order of the condition.
    bins, curve
        Calibration of the confidence.
    by_circumstance : tuple of tuple of Estimate
        Success in each group of each of the board's circumstances.
    statuses, reasons : mapping of str to int
        Number of frames with each.
    worst : WorstFrame or None
        None where all frames are correct.
    """

    stored: StoredResult
    metrics: Mapping[str, Estimate]
    success: Estimate
    rank: Rank
    break_point: Estimate
    levels: tuple[Level, ...]
    bins: tuple[ReliabilityBin, ...]
    curve: RiskCoverage
    by_circumstance: tuple[tuple[Estimate, ...], ...]
    statuses: Mapping[str, int]
    reasons: Mapping[str, int]
    worst: WorstFrame | None

    @property
    def label(self) -> str:
        """Name of the solver, with its key where the board holds more than one configuration of it."""
        return self.stored.label


@dataclass(frozen=True, eq=False)
class Board:
    """Solvers compared on the same frames, the best first."""

    task: TaskFacts
    split: str
    detections: str
    n_frames: int
    n_sites: int
    entries: tuple[Entry, ...]
    comparisons: tuple[Comparison, ...]
    detectable: float
    discrimination: Discrimination | None
    circumstances: tuple[Circumstance, ...]

    @property
    def file_name(self) -> str:
        """File name of the board's page."""
        return f"{self.task.key}-{self.split}-{self.detections}.html"

    @property
    def failures_file_name(self) -> str:
        """File name of the page that lists its failures."""
        return f"{self.file_name.removesuffix('.html')}-failures.html"

    @property
    def title(self) -> str:
        """Task and mode, for tables."""
        return f"{self.task.key}, {self.split}, {self.detections} detections"


def make_board(results: Sequence[StoredResult]) -> Board:
    """Compare the results on one set of frames in one mode of detection.

    Raises
    ------
    ResultsError
        They are not of the same frames.
    """
    first = results[0]
    for other in results[1:]:
        _check_same_frames(first, other)
    task = first.task if first.task.graded else _shown_by(first.task, first.frames)
    results = [dataclasses.replace(result, task=task) for result in results]
    limit_km = task.limit_km
    tables = {result.label: result.frames for result in results}
    comparisons = compare(tables, limit_km)
    placed = {rank.solver: rank for rank in ranks(tables, comparisons, limit_km=limit_km)}
    circumstances = _circumstances(first.frames, task)
    entries = [_entry(result, placed[result.label], circumstances) for result in results]
    entries.sort(key=lambda entry: (entry.rank.rank, entry.label))
    return Board(
        task=task,
        split=first.split,
        detections=first.detections,
        n_frames=len(first.frames),
        n_sites=int(first.frames["site"].nunique()),
        entries=tuple(entries),
        comparisons=comparisons,
        detectable=detectable(comparisons),
        discrimination=discrimination(tables, task.harder, limit_km=limit_km) if task.graded else None,
        circumstances=circumstances,
    )


def _check_same_frames(one: StoredResult, other: StoredResult) -> None:
    """Refuse to compare results of different frames. Raises ResultsError."""
    mine, theirs = one.provenance.frames, other.provenance.frames
    truths = {mine.truth_sha256, theirs.truth_sha256} - {""}  # results of earlier formats do not state it
    same = mine.scenario_sha256 == theirs.scenario_sha256 and len(truths) < 2
    others = identities_in(other.frames)
    same &= not any(others.get(name, UNKNOWN).contradicts(its) for name, its in identities_in(one.frames).items())
    if same and set(one.frames["frame_id"]) == set(other.frames["frame_id"]):
        return
    reason = (
        f"{len(one.frames)} and {len(other.frames)} frames"
        if len(one.frames) != len(other.frames)
        else "frames of different scenarios or generators"
    )
    raise ResultsError(
        f"{one.folder} and {other.folder}: {reason} cannot be compared; run both solvers again with the same --frames, "
        f"or delete the folder that is out of date"
    )


def _shown_by(task: TaskFacts, frames: pd.DataFrame) -> TaskFacts:
    """Show success by the first circumstance that varies, where nothing grades the frames."""
    for name, words, unit in _CIRCUMSTANCES:
        if pd.Series(column(frames, name)).nunique() > 1:
            return dataclasses.replace(task, condition=words, unit=unit, by=name)
    return task


def conditions_of(frames: pd.DataFrame, task: TaskFacts) -> F8:
    """Value by which success is shown, for each frame; NaN where it is unknown or nothing varies."""
    return column(frames, task.by) if task.by else np.full(len(frames), math.nan)


def _circumstances(frames: pd.DataFrame, task: TaskFacts) -> tuple[Circumstance, ...]:
    """Circumstances that vary from frame to frame besides the condition, each in a few groups of similar size."""
    graded = pd.Series(conditions_of(frames, task)).fillna(-math.inf)
    found = []
    for name, words, unit in _CIRCUMSTANCES:
        values = column(frames, name)
        # A circumstance that depends on the condition alone is shown by the condition.
        if name == task.by or np.isnan(values).any() or pd.Series(values).groupby(graded).nunique().max() < 2:
            continue
        groups = groups_of(values, _MOST_GROUPS)
        limits = tuple((float(values[group].min()), float(values[group].max())) for group in groups)
        found.append(Circumstance(name, words, unit, limits))
    return tuple(found)


def _successes(frames: pd.DataFrame, task: TaskFacts, circumstance: Circumstance) -> tuple[Estimate, ...]:
    values = column(frames, circumstance.column)
    metric = [success_metric(task.metric)]
    return tuple(
        measure(frames[(values >= low) & (values <= high)], metric)[task.metric] for low, high in circumstance.groups
    )


def _entry(result: StoredResult, rank: Rank, circumstances: Sequence[Circumstance]) -> Entry:
    frames, task = result.frames, result.task
    curve, limit_km = risk_coverage(frames, task.limit_km), task.limit_km
    asked = (*metrics_within(limit_km), *confidence_metrics_within(limit_km), *covariance_metrics_within(limit_km))
    metrics = measure(frames, [metric for metric in asked if metric.key != "risk_coverage_area"])
    metrics["risk_coverage_area"] = curve.area if curve.n_confidences else UNDEFINED
    statuses = Counter(frames["status"])
    return Entry(
        stored=result,
        metrics=metrics,
        success=measure(frames, [success_metric(task.metric)])[task.metric],
        rank=rank,
        break_point=break_point(frames, task.harder, limit_km=task.limit_km) if task.graded else _NO_BREAK,
        levels=_levels(frames, task),
        bins=reliability(frames, limit_km=limit_km),
        curve=curve,
        by_circumstance=tuple(_successes(frames, task, one) for one in circumstances),
        statuses={status: statuses[status] for status in (FIX, REFUSED, ERROR)},
        reasons=dict(Counter(reason for reason in frames["reason"] if reason).most_common()),
        worst=_worst(frames, task),
    )


def _levels(frames: pd.DataFrame, task: TaskFacts) -> tuple[Level, ...]:
    values = conditions_of(frames, task)
    metrics = [success_metric(task.metric), *(metric for metric in METRICS if metric.key == "median_error_km")]
    levels = []
    for group in groups_of(values, MOST_VALUES if task.graded else _MOST_SHOWN):
        part = frames[group]
        found = measure(part, metrics)
        bound = pd.Series(column(part, "crlb_km")).median()
        levels.append(
            Level(float(values[group].mean()), len(part), found[task.metric], found["median_error_km"], float(bound))
        )
    return tuple(levels)


def _worst(frames: pd.DataFrame, task: TaskFacts) -> WorstFrame | None:
    failed, values = ~succeeded(frames, task.limit_km), conditions_of(frames, task)
    if not failed.any():
        return None
    errors = pd.Series(errors_km(frames)).where(fixed(frames) & failed, -math.inf)
    if errors.max() > -math.inf:
        place = int(errors.argmax())
        words = f"fix off by {number(float(errors.max()), 'km')}"
        return WorstFrame(frames["frame_id"].iloc[place], float(values[place]), words)
    ease = pd.Series(-task.harder * values).fillna(-math.inf).where(failed, -math.inf)
    # Where no condition distinguishes the frames, take the first failure.
    place = int(ease.argmax()) if ease.max() > -math.inf else int(failed.argmax())
    return WorstFrame(frames["frame_id"].iloc[place], float(values[place]), str(frames["reason"].iloc[place]))
