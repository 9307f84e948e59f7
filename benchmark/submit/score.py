"""Scoring of a submission, with the same judge and the same files as for a solver that ran here."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

import numpy as np

import celnav
from benchmark.errors import ResultsError
from benchmark.frames.dataset import Frame, load_image
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.identity import identity_of
from benchmark.judge.answers import Response, check_answer, judge_answer
from benchmark.judge.frame_bounds import bound_of
from benchmark.judge.outcome import SolverOutcome
from benchmark.judge.star_id import score_matches
from benchmark.protocol import Answer
from benchmark.run.provenance import SolverFacts, provenance_of
from benchmark.run.result_tables import frame_table, match_table
from benchmark.run.results import check_solver_name, result_folder, write_result
from benchmark.solvers.registry import known_solvers
from benchmark.stats.metrics import FIX, REFUSED
from benchmark.submit.pack import withheld_names
from benchmark.submit.submission import Checked, FrameAnswer, StarRow

DETECTOR: Final = "submission"
"""Name of the detector in results of submissions; no solver that runs here has it."""


def names_in_use(frames: Sequence[Frame], answered: Collection[str]) -> dict[str, str]:
    """Names that a submission uses for the frames, by frame id: those of the set without truth, or the ids themselves."""
    withheld = withheld_names(frames)
    plain = {frame.frame_id: frame.frame_id for frame in frames}
    return plain if set(answered) & set(plain) and not set(answered) & set(withheld.values()) else withheld


def judge_submission(
    frames: Sequence[Frame], names: dict[str, str], answers: Checked, stars: Checked | None
) -> list[SolverOutcome]:
    """Judge each answer by the truth; a frame without an answer counts as refused.

    With a star table, a frame has at least the detections of a star that celnav's detector finds in it. Which detections a
    table contains is the submitter's choice, and omitting those without a name, or those of refused frames, must not raise
    recall.

    Parameters
    ----------
    frames : sequence of Frame
    names : dict of str to str
        Name of each frame in the submission, by frame id.
    answers, stars : Checked
        Checked tables without problems.
    """
    by_name = {answer.frame_id: answer for answer in answers.answers}
    rows = stars.stars if stars else {}
    outcomes = [
        _judge(frame, by_name.get(names[frame.frame_id]), rows.get(names[frame.frame_id], ())) for frame in frames
    ]
    if stars is None:
        return outcomes
    return [_with_detected_stars(outcome, frame) for outcome, frame in zip(outcomes, frames, strict=True)]


def _with_detected_stars(outcome: SolverOutcome, frame: Frame) -> SolverOutcome:
    """Give the outcome at least as many detections of a star as celnav's detector finds; a frame in memory has no image."""
    if not frame.image_path.name:
        return outcome
    found = score_matches(celnav.detect(load_image(frame)).uv, np.empty((0, 2), dtype=np.int64), frame.truth)
    most = max(outcome.score.n_detected_stars, found.n_detected_stars)
    return dataclasses.replace(outcome, score=dataclasses.replace(outcome.score, n_detected_stars=most))


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
    # A time that was not stated is not known to be finite.
    time_ms = math.inf if given is None or given.time_ms is None else given.time_ms
    response = Response(answer, status, uv, np.full(len(uv), np.nan), 0.0, time_ms, None)
    return judge_answer(frame, response, bound_of(frame), identity_of(frame))


def check_name(name: str) -> None:
    """Refuse a name that cannot be used as a file name, or that a solver of the benchmark has in capitals or small letters.

    Raises
    ------
    ResultsError
    """
    check_solver_name(name)
    if name.casefold() in {known.casefold() for known in known_solvers()}:
        raise ResultsError(f"name {name!r} is a solver of the benchmark; choose another for the submission")


def version_of(*paths: Path | None) -> str:
    """Version of a submission: the start of the hash of its files."""
    digest = hashlib.sha256()
    for path in paths:
        if path is not None:
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return f"sha256:{digest.hexdigest()[:12]}"


def write_score(frames: FrameSet, out: Path, name: str, version: str, outcomes: Sequence[SolverOutcome]) -> Path:
    """Write a judged submission to where the results of solvers on the same frames are stored.

    Parameters
    ----------
    frames : FrameSet
    out : Path
        Root of all results.
    name, version : str
    outcomes : sequence of SolverOutcome

    Returns
    -------
    Path
        Folder of its result.

    Raises
    ------
    ResultsError
        The name cannot be used.
    """
    check_name(name)
    solver = SolverFacts(
        target=None,
        kind=DETECTOR,
        title="submitted answers",
        licence="not stated",
        version=version,
        detector=DETECTOR,
        revision=version,
        time_limit_s=None,
        memory_limit_mib=None,
    )
    source = provenance_of(name, solver, frames.facts, "own", jobs=1, here=False)
    folder = result_folder(out, name, source)
    write_result(folder, name, frame_table(outcomes), match_table(outcomes), source)
    return folder
