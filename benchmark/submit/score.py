"""Scoring a submission: the same judge and the same files as for a solver that ran here."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from benchmark import provenance
from benchmark.errors import ResultsError
from benchmark.frames.dataset import Dataset, Frame, load_image
from benchmark.frames.preview import preview_webp
from benchmark.frames.task_frames import TaskFrames
from benchmark.judge.frame_bounds import bound_of
from benchmark.protocol import Answer
from benchmark.run.result_tables import match_table
from benchmark.run.results import (
    PREVIEW_FOLDER,
    ResultFiles,
    RunProvenance,
    check_room,
    check_solver_name,
    write_atomically,
    write_result,
)
from benchmark.run.run import SolverOutcome, check_answer, judge_answer
from benchmark.run.task_run import KEY_DIGITS, task_facts
from benchmark.solvers.registry import known_solvers
from benchmark.stats.metrics import FIX, REFUSED
from benchmark.submit.pack import Truth, withheld_names
from benchmark.submit.submission import Checked, FrameAnswer, StarRow

DETECTOR = "submission"
"""Name of the detector in results that were submitted; no solver that runs here has it."""


def names_in_use(frames: Sequence[Frame], answered: Collection[str]) -> dict[str, str]:
    """Names that a submission uses for the frames, by frame id: those of the set without truth, or the ids themselves."""
    withheld = withheld_names(frames)
    plain = {frame.frame_id: frame.frame_id for frame in frames}
    return plain if set(answered) & set(plain) and not set(answered) & set(withheld.values()) else withheld


def judge_submission(
    frames: Sequence[Frame], names: dict[str, str], answers: Checked, stars: Checked | None
) -> list[SolverOutcome]:
    """Hold each answer against the truth; a frame without an answer is a refused one.

    Parameters
    ----------
    frames : sequence of Frame
    names : dict of str to str
        Name of each frame in the submission, by frame id.
    answers, stars : Checked
        Without problems.
    """
    by_name = {answer.frame_id: answer for answer in answers.answers}
    rows = stars.stars if stars else {}
    return [_judge(frame, by_name.get(names[frame.frame_id]), rows.get(names[frame.frame_id], ())) for frame in frames]


def _judge(frame: Frame, given: FrameAnswer | None, stars: Sequence[StarRow]) -> SolverOutcome:
    uv = np.array([(row.u_px, row.v_px) for row in stars], dtype=np.float64).reshape(-1, 2)
    named = [(i, row.star_id) for i, row in enumerate(stars) if row.star_id is not None]
    status = given.status if given else REFUSED
    ok = given is not None and status == FIX
    covariance = given.cov_km2 if given else None
    answer = Answer(
        ok=ok,
        reason="" if ok else f"submitted as {status}",
        lat_deg=given.lat_deg if given and ok else None,
        lon_deg=given.lon_deg if given and ok else None,
        cov_km2=None if covariance is None else np.array([covariance[:2], covariance[1:]]),
        confidence=given.confidence if given else None,
        matches=np.array(named, dtype=np.int64).reshape(-1, 2),
    )
    check_answer(answer, len(uv))
    # A time that was not given is not known to be finite.
    time_ms = math.inf if given is None or given.time_ms is None else given.time_ms
    return judge_answer(frame, answer, status, uv, np.full(len(uv), np.nan), 0.0, time_ms, None, bound_of(frame))


def check_name(name: str) -> None:
    """Refuse a name that is no file name, or that a solver of the benchmark has.

    Raises
    ------
    ResultsError
    """
    check_solver_name(name)
    if name in known_solvers():
        raise ResultsError(f"name {name!r} is a solver of the benchmark; choose another for the submission")


def version_of(*paths: Path | None) -> str:
    """Version of a submission: the start of the hash of its files."""
    digest = hashlib.sha256()
    for path in paths:
        if path is not None:
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return f"sha256:{digest.hexdigest()[:12]}"


def write_score(truth: Truth, out: Path, name: str, version: str, outcomes: Sequence[SolverOutcome]) -> Path:
    """Write a judged submission where the results of solvers on the same frames are.

    Parameters
    ----------
    truth : Truth
    out : Path
        Folder of results.
    name, version : str
    outcomes : sequence of SolverOutcome

    Returns
    -------
    Path
        Its summary.

    Raises
    ------
    ResultsError
        The name cannot be used, or `out` holds results on another dataset.
    """
    check_name(name)
    if truth.task is not None:
        key = _key(name, version, truth.task)
        folder = out / truth.task.task.label / truth.task.split / "own" / f"{name}-{key}"
        files, found = ResultFiles.within(folder), _task_provenance(truth.task, version, key)
    else:
        assert truth.dataset is not None
        check_room(out, [name], truth.dataset.scenario_sha256, truth.dataset.truth_sha256)
        _write_previews(truth.dataset, out)
        files, found = ResultFiles.beside(out, name), _dataset_provenance(truth.dataset, version)
    write_result(
        files,
        name,
        [outcome.score for outcome in outcomes],
        [outcome.details for outcome in outcomes],
        match_table([row for outcome in outcomes for row in outcome.detections]),
        found,
    )
    return files.summary


def _write_previews(dataset: Dataset, out: Path) -> None:
    for frame in dataset.frames:
        preview = out / PREVIEW_FOLDER / f"{frame.frame_id}.webp"
        if frame.image_path.is_file() and not preview.is_file():
            write_atomically(preview, preview_webp(load_image(frame)))


def _dataset_provenance(dataset: Dataset, version: str) -> RunProvenance:
    return RunProvenance(
        dataset=dataset.name,
        scenario_name=dataset.scenario_name,
        scenario_sha256=dataset.scenario_sha256,
        truth_sha256=dataset.truth_sha256,
        dataset_provenance=dataset.provenance,
        solver_version=version,
        detector=DETECTOR,
        versions=provenance.versions(),
        machine=dict.fromkeys(provenance.machine(), "not stated"),
        date_utc=provenance.now_utc(),
        jobs=1,
    )


def _task_provenance(frames: TaskFrames, version: str, key: str) -> RunProvenance:
    return RunProvenance(
        dataset=frames.task.label,
        scenario_name=frames.task.scenario_of(frames.split).name,
        scenario_sha256=frames.scenario_sha256,
        truth_sha256="",
        dataset_provenance={},
        solver_version=version,
        detector=DETECTOR,
        versions=provenance.versions(),
        machine=dict.fromkeys(provenance.machine(), "not stated"),
        date_utc=provenance.now_utc(),
        jobs=1,
        task={
            **task_facts(frames, "own"),
            "solver_title": "submitted answers",
            "solver_licence": "",
            "key": key,
        },
    )


def _key(name: str, version: str, frames: TaskFrames) -> str:
    parts = [name, version, DETECTOR, frames.task.sha256, frames.scenario_sha256, frames.per_condition]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:KEY_DIGITS]
