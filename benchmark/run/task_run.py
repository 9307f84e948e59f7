"""Running solvers over tasks: what is done is found by its path and left alone, what is missing is done."""

from __future__ import annotations

import hashlib
import json
import queue
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from benchmark import provenance
from benchmark.errors import ResultsError, SolverError
from benchmark.frames.dataset import Frame
from benchmark.frames.task_frames import TaskFrames
from benchmark.judge.frame_bounds import bound_of
from benchmark.protocol import Answer, Detections
from benchmark.run.result_tables import FrameDetails, match_table
from benchmark.run.results import SUMMARY_NAME, ResultFiles, RunProvenance, write_result
from benchmark.run.run import SolverOutcome, check_answer, judge_answer
from benchmark.run.shared_detections import shared_detections, shared_detector
from benchmark.solvers.definition import SolverFolder
from benchmark.solvers.messages import reply_of, request_of
from benchmark.solvers.program import ProgramFailedError, ProgramSession
from benchmark.solvers.registry import missing_message, missing_packages
from benchmark.solvers.revision import installed_packages
from benchmark.stats.metrics import ERROR, FIX, REFUSED, FrameScore

DetectionsMode = Literal["own", "shared"]
KEY_DIGITS = 12


@dataclass(frozen=True)
class TaskRun:
    """One solver on one split of a task, and where its result belongs.

    Attributes
    ----------
    frames : TaskFrames
    solver : SolverFolder
    solver_version : str
        As the solver says it.
    detections : str
        ``own``: each solver detects by itself; ``shared``: all get celnav's detections.
    """

    frames: TaskFrames
    solver: SolverFolder
    solver_version: str
    detections: DetectionsMode

    @property
    def key(self) -> str:
        """Digest of all that may change a result: solver and its revision, task, frames, detections."""
        parts = [
            self.solver.name,
            self.solver.revision,
            self.frames.task.sha256,
            self.frames.scenario_sha256,
            shared_detector() if self.detections == "shared" else "own",
        ]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:KEY_DIGITS]

    def folder(self, out: Path) -> Path:
        """Folder of the result."""
        name = f"{self.solver.name}-{self.key}"
        return out / self.frames.task.label / self.frames.split / self.detections / name


def frames_done(folder: Path) -> int:
    """Frames a condition that a result was made with; 0 where there is none.

    Raises
    ------
    ResultsError
        Its summary is damaged.
    """
    path = folder / SUMMARY_NAME
    if not path.is_file():
        return 0
    try:
        return int(json.loads(path.read_text(encoding="utf-8"))["provenance"]["task"]["frames_per_condition"])
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise ResultsError(f"{path}: not a readable result ({error!r}); delete {folder}") from error


class SolverPool:
    """Sessions of one solver, as many as are needed at the same time.

    Raises
    ------
    SolverError
        The solver cannot be started here.
    """

    def __init__(self, solver: SolverFolder, jobs: int) -> None:
        missing = missing_packages(solver)
        if missing:
            raise SolverError(missing_message(solver, missing))
        self.solver = solver
        self.jobs = jobs
        place = solver.folder if solver.spec.command else Path.cwd()
        command = solver.command
        self._sessions = [ProgramSession(command, place, solver.limits) for _ in range(jobs)]
        self._warm: set[ProgramSession] = set()
        self._idle: queue.LifoQueue[ProgramSession] = queue.LifoQueue()
        for session in self._sessions:
            self._idle.put(session)
        try:
            self.version = self._start(self._sessions[-1])
        except SolverError:
            self.close()
            raise

    def _start(self, session: ProgramSession) -> str:
        version = str(session.start().get("version", ""))
        declared = self.solver.spec.version
        if declared is not None and version != declared:
            raise SolverError(f"{self.solver.name}: its program says version {version!r}, its solver.yaml {declared!r}")
        return version

    def answer(self, frame: Frame, shared: Detections | None) -> SolverOutcome:
        """Put a frame to the solver and judge its answer; whatever goes wrong is a refusal of that frame."""
        session = self._idle.get()
        try:
            return self._answer(session, frame, shared)
        finally:
            self._idle.put(session)

    def _answer(self, session: ProgramSession, frame: Frame, shared: Detections | None) -> SolverOutcome:
        request = request_of(frame, shared)
        uv, flux = np.empty((0, 2)), np.empty(0)
        detect_ms, memory_mib = 0.0, None
        try:
            if not session.running:
                self._warm.discard(session)
                self._start(session)
            if session not in self._warm:
                self._warm.add(session)
                self._warm_up(session, request)
            exchange = session.ask(request)
            time_ms, memory_mib = exchange.time_ms, exchange.peak_memory_mib
            reply = reply_of(exchange.message, frame.frame_id, frame.observation, shared)
            check_answer(reply.answer, len(reply.uv))
            answer, status = reply.answer, FIX if reply.answer.ok else REFUSED
            uv, flux, detect_ms = reply.uv, reply.flux, min(reply.detect_ms, time_ms)
        except ProgramFailedError as error:
            answer, status, time_ms = Answer(ok=False, reason=str(error)), ERROR, error.time_ms
        except SolverError as error:
            answer, status, time_ms = Answer(ok=False, reason=f"error: {error}"), ERROR, 0.0
        except ValueError as error:
            answer, status = Answer(ok=False, reason=f"error: {error}"), ERROR
        solve_ms = time_ms - detect_ms
        return judge_answer(frame, answer, status, uv, flux, detect_ms, solve_ms, memory_mib, _bound_km(frame))

    def _warm_up(self, session: ProgramSession, request: dict[str, Any]) -> None:
        """Put the first request once without judging it, so that one-off loading of tables does not count as solving."""
        try:
            session.ask(request)
        except ProgramFailedError:
            self._start(session)

    def close(self) -> None:
        """End all its processes."""
        for session in self._sessions:
            session.close()


@contextmanager
def solver_pool(solver: SolverFolder, jobs: int) -> Iterator[SolverPool]:
    """Start a solver, and end it whatever happens.

    Raises
    ------
    SolverError
        It cannot be started here.
    """
    pool = SolverPool(solver, jobs)
    try:
        yield pool
    finally:
        pool.close()


def run_task(run: TaskRun, pool: SolverPool, out: Path, progress: Callable[[int], None] = lambda frames: None) -> bool:
    """Do a run unless its result is there already, made with as many frames or more.

    Parameters
    ----------
    run : TaskRun
    pool : SolverPool
        Of the run's solver.
    out : Path
        Folder of all results.
    progress : callable
        Called with the number of frames done.

    Returns
    -------
    bool
        Whether there was anything to do.
    """
    folder = run.folder(out)
    if frames_done(folder) >= run.frames.per_condition:
        progress(len(run.frames.frames))
        return False

    def solve(frame: Frame) -> tuple[FrameScore, FrameDetails, pa.Table]:
        shared = shared_detections(frame) if run.detections == "shared" else None
        outcome = pool.answer(frame, shared)
        progress(1)
        return outcome.score, outcome.details, match_table(outcome.detections)

    with ThreadPoolExecutor(pool.jobs) as threads:
        outcomes = list(threads.map(solve, run.frames.frames))
    write_result(
        ResultFiles.within(folder),
        run.solver.name,
        [score for score, _, _ in outcomes],
        [details for _, details, _ in outcomes],
        pa.concat_tables([matches for _, _, matches in outcomes]),
        _provenance(run, pool.jobs),
    )
    return True


# A frame's bound is the same for all solvers, which come to it one after another.
_bounds_km: dict[tuple[Path, str], float | None] = {}


def _bound_km(frame: Frame) -> float | None:
    place = frame.image_path, frame.frame_id
    if place not in _bounds_km:
        _bounds_km[place] = bound_of(frame)
    return _bounds_km[place]


def _provenance(run: TaskRun, jobs: int) -> RunProvenance:
    return RunProvenance(
        dataset=run.frames.task.label,
        scenario_name=run.frames.task.scenario_of(run.frames.split).name,
        scenario_sha256=run.frames.scenario_sha256,
        truth_sha256="",
        dataset_provenance={},
        solver_version=run.solver_version,
        detector="shared: celnav" if run.detections == "shared" else "own",
        versions=provenance.versions(),
        machine=provenance.machine(),
        date_utc=provenance.now_utc(),
        jobs=jobs,
        task={
            **task_facts(run.frames, run.detections),
            "solver_title": run.solver.spec.title,
            "solver_licence": run.solver.spec.licence,
            "solver_revision": run.solver.revision,
            "detector_revision": installed_packages().detector_revision if run.detections == "shared" else None,
            "time_limit_s": run.solver.limits.time_s,
            "memory_limit_mib": run.solver.limits.memory_mib,
            "key": run.key,
        },
    )


def task_facts(frames: TaskFrames, detections: DetectionsMode) -> dict[str, Any]:
    """What a result's provenance says of its task."""
    definition = frames.task.definition
    return {
        "name": definition.name,
        "revision": definition.revision,
        "sha256": frames.task.sha256,
        "title": definition.title,
        "split": frames.split,
        "detections": detections,
        "frames_per_condition": frames.per_condition,
        "condition": definition.condition.model_dump(mode="json"),
        "metric": definition.metric.model_dump(mode="json"),
    }
