"""The engine: puts frames to solver sessions, judges the answers and stores the results.

A finished result, raw or packed, is found by its path and left alone; an interrupted run resumes where it stopped.
"""

from __future__ import annotations

import dataclasses
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmark.errors import ResultsError, SolverError
from benchmark.frames.dataset import Frame
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.identity import FrameIdentity, identity_of
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.judge.answers import judge_answer
from benchmark.judge.frame_bounds import bound_of
from benchmark.judge.outcome import SolverOutcome
from benchmark.provenance import now_utc
from benchmark.run.contestants import Contestant, SolverChoice, contestant_of
from benchmark.run.finished import finished, finished_raw
from benchmark.run.identities import Recorded, check_identity, recorded_identities
from benchmark.run.journal import Journal
from benchmark.run.provenance import DetectionsMode, provenance_of
from benchmark.run.renewal import earlier_row, frames_as_before, outcome_before, raw_folders, renewed
from benchmark.run.results import check_writable, result_folder, write_result, writing
from benchmark.run.sessions import Session, SessionPool, asked_together, session_pool
from benchmark.run.shared_detections import shared_detections
from benchmark.stats.metrics import Summary

_NO_CHOICE = FrameChoice()


@dataclass(frozen=True)
class FrameNotes:
    """What is the same for all solvers on a frame: its Cramér-Rao bound, km, and the hashes of its image and truth."""

    bound_km: float | None
    identity: FrameIdentity


Notes = dict[str, FrameNotes]


@dataclass(frozen=True)
class SolverRun:
    """One solver's run on one set of frames.

    Attributes
    ----------
    solver : str
    folder : Path
        Folder of its result, whether it exists or is packed.
    summary : Summary
    n_solved : int
        Frames that were solved in this run: 0 where the result was finished before, fewer than all where a run resumed.
    seconds : float
        Duration of this run.
    n_kept : int
        Frames whose answers are those of an earlier result.
    """

    solver: str
    folder: Path
    summary: Summary
    n_solved: int
    seconds: float
    n_kept: int = 0

    @property
    def failed_throughout(self) -> bool:
        """Whether every answer was an error."""
        return self.summary.n_errors == self.summary.n_frames


@dataclass(frozen=True, eq=False)
class _Run:
    """A solver that is ready, and the frames on which it is to be run."""

    contestant: Contestant
    pool: SessionPool
    frames: FrameSet
    detections: DetectionsMode
    notes: Notes
    renew: bool


def run(
    frames: FrameSet | str | Path,
    solvers: Sequence[SolverChoice],
    out: Path,
    *,
    detections: DetectionsMode = "own",
    jobs: int = 1,
    choice: FrameChoice = _NO_CHOICE,
    progress: Callable[[str, int], None] = lambda solver, frames: None,
) -> tuple[SolverRun, ...]:
    """Run solvers over frames, judge their answers and write the results.

    A solver that raises, or whose answer is invalid, is scored as refusing that frame with status ``error``.

    Parameters
    ----------
    frames : FrameSet, str or Path
        A set, or what `benchmark.frames.opening.open_frames` opens.
    solvers : sequence
        Names of solvers, folders with a solver.yaml, or Python objects (`benchmark.protocol.SolverUnderTest`).
    out : Path
        Root of all results, created if missing.
    detections : str
        ``own``: each solver detects by itself; ``shared``: all receive celnav's detections.
    jobs : int
        Number of frames that are solved in parallel; with more than one, the times include mutual slowdown.
    choice : FrameChoice
        Which frames to open, where `frames` names them.
    progress : callable
        Called with a solver's name and the number of its frames that are done.

    Returns
    -------
    tuple of SolverRun
        In the order of the solvers.

    Raises
    ------
    UnknownSolverError, SolverError, DatasetError, TaskError, ResultsError
        Raised before any frame is solved, except for a damaged image, a solver that does not start and a full disk.
    """
    contestants = check_contestants([contestant_of(solver) for solver in solvers], jobs)
    check_writable(out)
    found = frames if isinstance(frames, FrameSet) else open_frames(str(frames), choice)
    check_sequences(contestants, [found])
    return tuple(run_all(contestants, [found], out, detections, jobs, progress))


def run_all(
    contestants: Sequence[Contestant],
    sets: Sequence[FrameSet],
    out: Path,
    detections: DetectionsMode,
    jobs: int,
    progress: Callable[[str, int], None] = lambda solver, frames: None,
    notes: Sequence[Notes] | None = None,
    renew: bool = False,
) -> Iterator[SolverRun]:
    """Run each solver over all sets of frames, one solver after another.

    Parameters
    ----------
    contestants, sets, out, detections, jobs, progress
        See `run`.
    notes : sequence of Notes, optional
        Notes on each set, where some are known already; missing ones are added.
    renew : bool
        Take over the answers of earlier results for frames that are the same (`benchmark.run.renewal`). A result with such
        answers lacks what packing leaves out, so it must be packed; it replaces the solver's other raw results on these
        frames.
    """
    notes = [{} for _ in sets] if notes is None else notes
    for contestant in contestants:
        with session_pool(partial(contestant.make_session, jobs), jobs) as pool:
            for frames, known in zip(sets, notes, strict=True):
                found = _Run(contestant, pool, frames, detections, known, renew)
                yield _run_solver(found, out, partial(progress, contestant.name))


def check_contestants(contestants: Sequence[Contestant], jobs: int) -> Sequence[Contestant]:
    """Refuse, before any work, contestants that cannot be run together.

    Raises
    ------
    ResultsError
        No solver is given, one is given twice, or the number of jobs is below one.
    SolverError
        A solver cannot run here.
    """
    names = [contestant.name for contestant in contestants]
    if not names or len(set(names)) != len(names):
        raise ResultsError(f"give each solver once and at least one, found {', '.join(names) or 'none'}")
    if jobs < 1:
        raise ResultsError(f"jobs must be at least 1, found {jobs}")
    for contestant in contestants:
        if obstacle := contestant.obstacle():
            raise SolverError(obstacle)
    return contestants


def check_sequences(contestants: Sequence[Contestant], sets: Sequence[FrameSet]) -> None:
    """Refuse fused solvers on single frames, where they would answer exactly as the solvers that they wrap.

    Raises
    ------
    SolverError
    """
    alone = [one for one in sets if not any(frame.observation.sequence for frame in one.frames)]
    fused = [one.definition for one in contestants if one.definition is not None and one.definition.fused is not None]
    if alone and fused:
        raise SolverError(
            f"{fused[0].name}: fuses what is answered to the frames of a sequence, and those of {alone[0].facts.target} "
            f"are put one by one; name {fused[0].asked.name}, or a task of sequences such as uav (docs/sequences.md)"
        )


def _run_solver(found: _Run, out: Path, progress: Callable[[int], None]) -> SolverRun:
    """Run one solver over one set of frames, unless a finished result of at least as many frames exists.

    Parameters
    ----------
    found : _Run
    out : Path
        Root of all results.
    progress : callable
        Called with the number of frames done.
    """
    started = time.monotonic()
    contestant, frames = found.contestant, found.frames
    facts = contestant.facts(found.pool.version, found.detections)
    source = provenance_of(contestant.name, facts, frames.facts, found.detections, found.pool.jobs)
    folder = result_folder(out, contestant.name, source)
    # Renewal is asked for rows that are to be made, and takes their packed answers over itself.
    existing = (finished_raw if found.renew else finished)(out, contestant.name, source) if contestant.settled else None
    if existing is not None:
        progress(len(frames.frames))
        return SolverRun(contestant.name, folder, existing, 0, time.monotonic() - started)
    ids = [frame.frame_id for frame in frames.frames]
    stamp: dict[str, object] = {"versions": source.versions, "machine": source.machine, "jobs": source.jobs}
    journal = Journal(folder, stamp, contestant.settled)
    earlier = earlier_row(out, contestant.name, source) if found.renew else None
    kept: list[Frame] = []
    with writing(folder):
        recorded = recorded_identities(out, frames.facts)
        done = journal.take_over(frames.frames)
        if earlier is not None:
            kept = frames_as_before(earlier, frames.frames, lambda frame: noted(frame, found.notes).identity)
            for frame in kept:
                if frame.frame_id not in done:
                    known = noted(frame, found.notes)
                    journal.add(outcome_before(earlier, frame, known.bound_km, known.identity))
            done |= {frame.frame_id for frame in kept}
        progress(len(done))
        # An interrupted sequence is put again from its first frame; the answers it already has stay.
        groups = [group for group in asked_together(frames.frames) if any(one.frame_id not in done for one in group)]
        left = [frame for group in groups for frame in group]
        try:
            for outcome in outcomes(left, found.pool, found.detections, found.notes, recorded):
                if outcome.score.frame_id in done:
                    continue
                journal.add(outcome)
                progress(1)
        except BaseException:
            journal.flush()
            raise
        ended = dataclasses.replace(source, date_utc=now_utc())
        if earlier is not None and kept:
            ended = renewed(ended, earlier, len(kept), len(ids) - len(kept))
        summary = write_result(folder, contestant.name, *journal.tables(ids), ended)
        journal.clear()
        if found.renew:
            for replaced in raw_folders(out, contestant.name, source):
                if replaced != folder:
                    shutil.rmtree(replaced)
    return SolverRun(contestant.name, folder, summary, len(left), time.monotonic() - started, len(kept))


def noted(frame: Frame, notes: Notes) -> FrameNotes:
    """Look up the notes on a frame; compute and add them where they are missing."""
    if frame.frame_id not in notes:
        notes[frame.frame_id] = FrameNotes(bound_of(frame), identity_of(frame))
    return notes[frame.frame_id]


def outcomes(
    frames: Sequence[Frame],
    pool: SessionPool,
    detections: DetectionsMode,
    notes: Notes,
    recorded: Recorded | None = None,
) -> Iterator[SolverOutcome]:
    """Put frames to a solver and judge its answers, in the order of the frames.

    The frames of a sequence go to one session, one after another.

    Parameters
    ----------
    frames : sequence of Frame
        The frames of a sequence are adjacent and in order.
    pool : SessionPool
    detections : str
    notes : dict of str to FrameNotes
        By frame id; missing notes are computed and added.
    recorded : mapping, optional
        Identities of frames that results already state (`benchmark.run.identities`).

    Raises
    ------
    ResultsError
        A frame differs from the one that results are of; the solver is not asked about it.
    """

    def solve(frame: Frame, session: Session) -> SolverOutcome:
        known = noted(frame, notes)
        check_identity(frame.frame_id, known.identity, recorded or {})
        shared = shared_detections(frame) if detections == "shared" else None
        response = session.answer(frame, shared)
        return judge_answer(frame, response, known.bound_km, known.identity)

    def solve_in_order(group: Sequence[Frame]) -> list[SolverOutcome]:
        with pool.idle_session() as session:
            return [solve(frame, session) for frame in group]

    with ThreadPoolExecutor(pool.jobs) as threads:
        try:
            for judged in threads.map(solve_in_order, asked_together(frames)):
                yield from judged
        finally:
            threads.shutdown(wait=True, cancel_futures=True)
