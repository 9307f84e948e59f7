"""Scoring of a round: solvers that run here, and answers that were submitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.cli.progress import progress_bars
from benchmark.errors import ResultsError, RoundError
from benchmark.frames.frame_set import FrameSet
from benchmark.report.formatting import number, percent
from benchmark.rounds.commitment import OPENED
from benchmark.rounds.scored_answers import settle_answers
from benchmark.rounds.steps import Drawn, check_frozen, frames_to_score
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import check_contestants, run_all
from benchmark.run.provenance import DetectionsMode
from benchmark.run.results import check_writable
from benchmark.run.shared_detections import SHARED_DETECTIONS, shared_detector
from benchmark.stats.frame_metrics import success_limit_km
from benchmark.stats.metrics import Summary, summarise
from benchmark.submit.score import check_name, judge_submission, version_of, write_score
from benchmark.submit.submission import Checked, check_answers, check_stars


@dataclass(frozen=True)
class Scoring:
    """Input of the scoring: the round and its drawn frames, the truth, the set, and the folder of results.

    `later` puts the results apart, as those of solvers that were not settled before the frames were drawn.
    """

    folder: Path
    drawn: Drawn
    truth: Path
    packed: Path
    out: Path
    later: bool


@dataclass(frozen=True)
class Scored:
    """One contestant's result: its name and folder, and a description in words."""

    solver: str
    folder: Path
    words: str


def score_solvers(wanted: Scoring, names: Sequence[str], detections: DetectionsMode, jobs: int) -> list[Scored]:
    """Run solvers on the set and score them, each with its own detector or all with the same detections.

    Raises
    ------
    BenchmarkError
        A solver or the shared detector has changed since the commitment, or the frames are not those that were published.
    """
    contestants = check_contestants([contestant_of(name) for name in names], jobs)
    if not wanted.later:
        revisions = {one.name: one.definition.revision for one in contestants if one.definition is not None}
        if detections == "shared":
            revisions[SHARED_DETECTIONS] = shared_detector()
        check_frozen(wanted.drawn.commitment.terms, revisions)
    check_writable(wanted.out)
    frames = frames_to_score(wanted.folder, wanted.drawn, wanted.truth, wanted.packed, wanted.later)
    with progress_bars() as bar:
        lines = {one.name: bar.add_task(one.name, total=len(frames.frames)) for one in contestants}
        runs = run_all(
            contestants, [frames], wanted.out, detections, jobs, lambda name, count: bar.advance(lines[name], count)
        )
        return [Scored(run.solver, run.folder, _words(run.solver, run.summary, frames)) for run in runs]


def score_answers(wanted: Scoring, answers: Path, stars: Path | None, name: str) -> Scored:
    """Score answers that were submitted.

    Raises
    ------
    BenchmarkError
        They have faults, come from an entrant who is not in the commitment, arrive after the round was opened, or are others
        than those that were scored before.
    """
    check_name(name)
    terms = wanted.drawn.commitment.terms
    if not wanted.later and name not in terms.contestants:
        raise RoundError(f"{name}: was not committed to; score it with --later, apart from those that were")
    if not wanted.later and (opened := wanted.folder / OPENED).exists():
        raise RoundError(
            f"{opened}: with its secret anyone can make the truth; score answers that come now with --later"
        )
    frames = frames_to_score(wanted.folder, wanted.drawn, wanted.truth, wanted.packed, wanted.later)
    ids = {frame.frame_id: frame.frame_id for frame in frames.frames}
    given = _without_faults(answers, check_answers(answers, frozenset(ids)))
    table = None if stars is None else _without_faults(stars, check_stars(stars, frozenset(ids)))
    version = version_of(answers, stars)
    if not wanted.later:
        settle_answers(wanted.folder, wanted.drawn.commitment, wanted.out, name, version)
    outcomes = judge_submission(frames.frames, ids, given, table)
    folder = write_score(frames, wanted.out, name, version, outcomes)
    summary = summarise([outcome.score for outcome in outcomes], success_limit_km(frames.facts.metric))
    return Scored(name, folder, _words(name, summary, frames))


def _without_faults(path: Path, checked: Checked) -> Checked:
    if checked.problems:
        listed = "\n".join(f"{path}: {problem}" for problem in checked.problems[:20])
        raise ResultsError(f"{listed}\n{path}: {len(checked.problems)} faults; see `skybench bench check`")
    return checked


def _words(name: str, summary: Summary, frames: FrameSet) -> str:
    limit_km = success_limit_km(frames.facts.metric)
    return (
        f"{name}: {summary.n_frames} frames, {summary.n_fixes} fixes, "
        f"{percent(summary.recall.value)} within {limit_km:g} km, "
        f"median error {number(summary.median_error_km.value, 'km')}"
    )
