"""The part of the replication that uses pictures: rendering, detection, all contestants, three orders of history."""

from __future__ import annotations

import dataclasses
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import celnav
from benchmark.errors import DatasetError
from benchmark.frames.dataset import Dataset, Frame, load_image, open_dataset
from benchmark.studies.common.contestants import Contestant, judge_detections
from benchmark.studies.common.progress import Advance
from benchmark.studies.common.records import Row, row_of
from benchmark.studies.thesis import contestants as who
from celnav.solver import SOLVERS
from generator.scenario.file import Scenario, load_scenario
from generator.seeds import random_stream

PART = "pictures"
HISTORY_ORDERS = ("reset", "carried, sets in turn", "carried, shuffled")
# A star counts as detected when a detection is within this distance.
DETECTED_PX = 1.5
DEPTH_BIN_MAG = 0.25
LEAST_STARS_IN_BIN = 20


@dataclass(frozen=True)
class Depth:
    """Depth of the pictures of one label.

    Attributes
    ----------
    label_mag : float
    half_mag : float
        Faint end of the bins of 0.25 mag, from bright to faint, in which at least half of the stars are detected.
    detections : float
        Median number per frame.
    n_frames : int
    """

    label_mag: float
    half_mag: float
    detections: float
    n_frames: int


@dataclass(frozen=True)
class RenderedPart:
    """All results from pictures."""

    dataset: Dataset
    rows: tuple[Row, ...]
    depths: tuple[Depth, ...]


def render_scenario(path: Path, repeats: int | None, folder: Path, progress: Advance) -> Scenario:
    """Render a scenario, with `repeats` frames for each label if given."""
    from generator.frame.render import render_dataset  # loads Mitsuba, which a finished dataset does not need

    scenario = study_scenario(path, repeats)
    render_dataset(scenario, folder, lambda frame: progress())
    return scenario


def study_scenario(path: Path, repeats: int | None) -> Scenario:
    """Load a scenario and change its number of frames per label if asked."""
    scenario = load_scenario(path)
    return scenario if repeats is None else dataclasses.replace(scenario, repeats=repeats)


def solve_pictures(folder: Path, progress: Advance) -> RenderedPart:
    """Detect and solve all frames of a dataset.

    Raises
    ------
    DatasetError
        The folder is not a dataset, or its frames have no limiting magnitude.
    """
    dataset = open_dataset(folder)
    contestants = [*who.registered(), *who.literal(), who.one_star()]
    rows: list[Row] = []
    seen: list[tuple[Frame, celnav.Detections, float, float]] = []
    for frame in dataset.frames:
        image = load_image(frame)
        start = time.perf_counter()
        detections = celnav.detect(image)
        detect_ms = 1000.0 * (time.perf_counter() - start)
        label = _label(folder, frame)
        outcomes = judge_detections(frame, detections, contestants, warm_up=not seen)
        for contestant, outcome in zip(contestants, outcomes, strict=True):
            rows.append(row_of(PART, label, contestant.name, outcome, detect_ms))
        seen.append((frame, detections, label, detect_ms))
        progress()
    rows += _with_history(seen)
    return RenderedPart(dataset, tuple(rows), _depths(folder, seen))


def _label(folder: Path, frame: Frame) -> float:
    record = json.loads((folder / f"{frame.frame_id}.json").read_text(encoding="utf-8"))
    try:
        return float(record["stars"]["limiting_magnitude"])
    except (KeyError, TypeError, ValueError):
        raise DatasetError(
            f"{folder / frame.frame_id}.json: has no stars.limiting_magnitude, which the study sorts by"
        ) from None


def _with_history(seen: list[tuple[Frame, celnav.Detections, float, float]]) -> list[Row]:
    """`thesis-adaptive` with its history reset for each frame, carried through set after set, and carried shuffled."""
    solver = SOLVERS[who.ADAPTIVE]
    shuffled = random_stream(1, "study.order_of_frames", 0).permutation(len(seen))
    rows = []
    for order in HISTORY_ORDERS:
        history = celnav.History()
        for place in shuffled if order.endswith("shuffled") else range(len(seen)):
            frame, detections, label, detect_ms = seen[int(place)]
            if order == "reset":
                history = celnav.History()
            contestant = Contestant(order, solver, history)
            (outcome,) = judge_detections(frame, detections, [contestant])
            rows.append(row_of("history", label, order, outcome, detect_ms))
    return sorted(rows, key=lambda row: (row.contestant, row.frame_id))


def _depths(folder: Path, seen: list[tuple[Frame, celnav.Detections, float, float]]) -> tuple[Depth, ...]:
    table = pq.read_table(folder / "stars.parquet", columns=["frame_id", "v_mag", "u_px", "v_px"])
    frame_ids = np.asarray(table["frame_id"].to_pylist(), dtype=str)
    v_mag = table["v_mag"].to_numpy().astype(np.float64)
    uv = np.column_stack((table["u_px"].to_numpy(), table["v_px"].to_numpy()))
    by_label: dict[float, list[tuple[NDArray[np.float64], NDArray[np.bool_], int]]] = {}
    for frame, detections, label, _ in seen:
        camera = frame.observation.camera
        within = (uv > 0).all(axis=1) & (uv[:, 0] < camera.width - 1) & (uv[:, 1] < camera.height - 1)
        rows = np.flatnonzero(within & (frame_ids == frame.frame_id))
        nearest_px = np.full(len(rows), np.inf)
        if len(detections) and len(rows):
            nearest_px = np.asarray(cKDTree(detections.uv).query(uv[rows])[0], dtype=np.float64)
        found = np.asarray(nearest_px <= DETECTED_PX)
        by_label.setdefault(label, []).append((v_mag[rows], found, len(detections)))
    depths = []
    for label in sorted(by_label, reverse=True):
        parts = by_label[label]
        mags, found = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
        depths.append(Depth(label, half_depth(mags, found), float(np.median([p[2] for p in parts])), len(parts)))
    return tuple(depths)


def half_depth(v_mag: NDArray[np.float64], found: NDArray[np.bool_]) -> float:
    """Return the magnitude down to which at least half of the stars in every bin of 0.25 mag are found.

    Parameters
    ----------
    v_mag : ndarray, shape (n,)
        Magnitudes of stars in the field.
    found : ndarray of bool, shape (n,)
        Whether each of them has a detection.

    Returns
    -------
    float
        Faint end of the last such bin, or the faintest star's magnitude where the list ends earlier. Bins of fewer than 20
        stars do not count. NaN where even the brightest bin falls short.
    """
    depth = float("nan")
    bins = np.floor(v_mag / DEPTH_BIN_MAG).astype(np.int64)
    for number in np.unique(bins):
        here = found[bins == number]
        if len(here) < LEAST_STARS_IN_BIN:
            continue
        if here.mean() < 0.5:
            break
        depth = min((int(number) + 1) * DEPTH_BIN_MAG, float(v_mag.max()))
    return depth
