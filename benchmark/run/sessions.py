"""Solver sessions: a session puts a frame to a solver and returns a checked answer, whatever the solver does.

There are two kinds: a Python object, in this process (`InProcessSession`) or in its own (`OtherProcessSession`), and a
program over a pipe (`PipeSession`).
"""

from __future__ import annotations

import dataclasses
import os
import queue
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import DatasetError, SolverError
from benchmark.frames.dataset import Frame, load_image
from benchmark.frames.truth_folders import truth_folders
from benchmark.judge.answers import Response, check_answer, check_points, failure, points_of
from benchmark.protocol import Detections, SolverUnderTest
from benchmark.run.focal_retry import at_focal_lengths, focal_factors, shares
from benchmark.run.pinhole_frames import PinholeFrame, as_pinhole, is_centred_pinhole
from benchmark.solvers.definition import SolverFolder
from benchmark.solvers.isolation import ISOLATED, NOT_ISOLATED, isolation_obstacle, visible_places
from benchmark.solvers.memory import peak_mib, reset_peak
from benchmark.solvers.messages import answers, reply_of, request_of
from benchmark.solvers.program import ProgramFailedError, ProgramSession
from benchmark.stats.metrics import ERROR, FIX, REFUSED
from celnav.identification.sky_index import load_deep_sky_index, load_sky_index
from generator.processes import follow_parent


class Session(Protocol):
    """One solver that answers one frame at a time."""

    def start(self) -> str:
        """Start the solver and return its version. Raises SolverError where it cannot run here."""

    def answer(self, frame: Frame, shared: Detections | None) -> Response:
        """Put a frame to the solver, with the detections that it is to use; with None it detects by itself.

        The frames of a sequence come in order, without other frames between them.
        """

    def close(self) -> None:
        """End whatever was started."""


def asked_together(frames: Sequence[Frame]) -> list[list[Frame]]:
    """Group frames that one session answers in order: each sequence is a group, and so is each single frame."""

    def key(frame: Frame) -> tuple[str, str]:
        place = frame.observation.sequence
        return ("frame", frame.frame_id) if place is None else ("sequence", place.sequence_id)

    return [list(group) for _, group in groupby(frames, key)]


def isolation_of_programs(reads: Sequence[str] = ()) -> str:
    """How a solver's process is kept from files and network; with the places that its definition lets it read besides."""
    if isolation_obstacle():
        return NOT_ISOLATED
    return f"{ISOLATED}; it also reads {', '.join(reads)}" if reads else ISOLATED


@dataclass(frozen=True)
class _Found:
    """Detections that a program found earlier."""

    uv: NDArray[np.float64]
    flux: NDArray[np.float64] | None


@dataclass(frozen=True)
class _Time:
    """Time within a frame's limit, s: the most that a request should take, and what earlier requests have taken."""

    share_s: float
    spent_s: float = 0.0


class PipeSession:
    """A solver's program, which is restarted after every frame that it did not survive.

    It reads each image in a folder that holds nothing else, because the truth is stored next to the original. It is isolated
    where the system allows it. An adapter is started in the image's folder, a command in its own.
    """

    def __init__(self, solver: SolverFolder, on_stderr: Callable[[bytes], None] | None = None) -> None:
        self._solver = solver
        self._folder: tempfile.TemporaryDirectory[str] | None = tempfile.TemporaryDirectory(prefix="skybench-frame-")
        self._empty = tempfile.TemporaryDirectory(prefix="skybench-empty-")
        place = solver.folder if solver.spec.command else Path(self._folder.name)
        command = solver.command_line()
        places = None
        if isolation_of_programs() == ISOLATED:
            # Isolated processes see celnav's cache but cannot write to it, so its large tables are made outside.
            load_sky_index()
            load_deep_sky_index()
            places = visible_places(command, place, [Path(self._folder.name), *solver.reads])
            if solver.spec.command:
                places |= {str(hidden): self._nothing_like(hidden) for hidden in solver.uncounted}
        self._program = ProgramSession(command, place, solver.limits, on_stderr, places)
        self._warm = False
        self._asked = 0

    def start(self) -> str:
        """Start the program. Raises SolverError."""
        version = str(self._program.start().get("version", ""))
        declared = self._solver.spec.version
        if declared is not None and version != declared:
            raise SolverError(
                f"{self._solver.name}: its program says version {version!r}, its solver.yaml {declared!r}"
            )
        return version

    def answer(self, frame: Frame, shared: Detections | None) -> Response:
        """Ask the program; any failure counts as a refusal of this frame.

        A program that does not search the focal length by itself is asked again when it refuses
        (`benchmark.run.focal_retry`), with the detections that it has found. The times add up, and the frame's limit applies
        to their sum.
        """
        limit_s = self._solver.limits.time_s
        factors = focal_factors(frame.observation) if self._solver.spec.focal_retries else ()
        share, *later = shares(len(factors))
        first = self._asked_once(frame, shared, _Time(share * limit_s))
        if first.status != REFUSED or not factors:
            return first
        found = shared if shared is not None or not len(first.uv) else _Found(first.uv, first.flux)
        responses = [first]
        for other, share in zip(at_focal_lengths(frame, factors), later, strict=True):
            spent_s = sum(one.detect_ms + one.solve_ms for one in responses) / 1000.0
            if spent_s >= limit_s:
                break
            responses.append(self._asked_once(other, found, _Time(share * (limit_s - spent_s), spent_s)))
            if responses[-1].status == FIX:
                break
        # The reason given for a refusal is that for the supplied focal length.
        chosen = responses[-1] if responses[-1].status == FIX else first
        memory = [one.peak_memory_mib for one in responses if one.peak_memory_mib is not None]
        solve_ms = sum(one.detect_ms + one.solve_ms for one in responses) - first.detect_ms
        return dataclasses.replace(
            chosen, detect_ms=first.detect_ms, solve_ms=solve_ms, peak_memory_mib=max(memory, default=None)
        )

    def _asked_once(self, frame: Frame, shared: Detections | None, allowed: _Time) -> Response:
        """Ask about a frame with its supplied camera; a program that only supports pinholes gets a pinhole's view of it."""
        if self._solver.spec.lens == "any" or is_centred_pinhole(frame.observation.camera):
            return self._put(frame, shared, None, allowed)
        shown = as_pinhole(frame, shared)
        response = shown.back(self._put(shown.frame, shown.shared, shown, allowed), shared)
        if shared is None or len(response.uv):
            return response
        uv, flux = points_of(shared)  # the pinhole shows none of them
        return dataclasses.replace(response, uv=uv, flux=flux)

    def _put(self, frame: Frame, shared: Detections | None, shown: PinholeFrame | None, allowed: _Time) -> Response:
        """Put a request to the program; with `shown`, it gets the image of that pinhole."""
        if self._solver.spec.command:
            self._solver.check_apart_from(truth_folders(frame))
        try:
            request = request_of(frame, shared, self._shown(frame.image_path, shown), allowed.share_s)
        except OSError as error:
            raise DatasetError(f"{frame.image_path}: cannot be read ({error.strerror})") from error
        try:
            if not self._program.running:
                self._warm = False
                self.start()
            if not self._warm:
                self._warm = True
                self._warm_up(request_of(by_itself(frame), shared, Path(request["image"]), allowed.share_s))
            exchange = self._program.ask(request, allowed.spent_s)
        except ProgramFailedError as error:
            return failure(str(error), error.time_ms, shared)
        except SolverError as error:
            return failure(f"error: {error}", 0.0, shared)
        try:
            reply = reply_of(exchange.message, frame.frame_id, frame.observation, shared)
            check_points(reply.uv, reply.flux)
            check_answer(reply.answer, len(reply.uv))
        except ValueError as error:
            if not answers(exchange.message, frame.frame_id):
                # What it prints later could be the answer that belongs here, so it begins anew.
                self._program.close()
            return failure(f"error: {error}", exchange.time_ms, shared)
        detect_ms = min(reply.detect_ms, exchange.time_ms)
        return Response(
            answer=reply.answer,
            status=FIX if reply.answer.ok else REFUSED,
            uv=reply.uv,
            flux=reply.flux,
            detect_ms=detect_ms,
            solve_ms=exchange.time_ms - detect_ms,
            peak_memory_mib=exchange.peak_memory_mib,
        )

    def _warm_up(self, request: dict[str, Any]) -> None:
        """Put the first request once without judging it, so that one-off loading of tables does not count as solving."""
        try:
            self._program.ask(request)
        except ProgramFailedError:
            self.start()

    def _nothing_like(self, hidden: Path) -> str:
        """An empty folder, or an empty file."""
        return self._empty.name if hidden.is_dir() else os.devnull

    def _shown(self, image: Path, by_pinhole: PinholeFrame | None) -> Path:
        """Place an image, alone and under an unused name, where the program may read it. Raises OSError."""
        assert self._folder is not None, "the session is closed"
        folder = Path(self._folder.name)
        for before in folder.iterdir():
            before.unlink()
        self._asked += 1
        shown = folder / f"{self._asked}{image.suffix}"
        if by_pinhole is None:
            shutil.copyfile(image, shown)  # a copy, no link: the program may write to it
        else:
            by_pinhole.write_image(shown)
        return shown

    def close(self) -> None:
        """End the program and everything that it has started."""
        self._program.close()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None
            self._empty.cleanup()


class InProcessSession:
    """A Python object in this process. It gets copies and a read-only image, and may raise any exception."""

    def __init__(self, solver: SolverUnderTest) -> None:
        self._solver = solver
        self._warm = False

    def start(self) -> str:
        """Nothing to start."""
        return self._solver.version

    def answer(self, frame: Frame, shared: Detections | None) -> Response:
        """Ask the object. Raises DatasetError where the image is damaged."""
        image = load_image(frame)
        if not self._warm:
            self._warm = True
            ask(self._solver, by_itself(frame), image, shared)
        return ask(self._solver, frame, image, shared)

    def close(self) -> None:
        """Nothing to end."""


def by_itself(frame: Frame) -> Frame:
    """A frame without its sequence, for requests that are not judged and must not count as frames of the sequence."""
    return dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, sequence=None))


def ask(solver: SolverUnderTest, frame: Frame, image: NDArray[np.uint16], shared: Detections | None = None) -> Response:
    """Put a frame to a Python object; an exception or an invalid answer counts as a refusal of this frame.

    Parameters
    ----------
    solver : SolverUnderTest
    frame : Frame
        The solver receives only its `observation`, the image and the detections.
    image : ndarray of uint16, shape (height, width)
        DN.
    shared : Detections, optional
        To be used instead of the solver's own.
    """
    # A read-only copy: no solver may change what the next one sees.
    image = image.copy()
    image.flags.writeable = False
    known = reset_peak()
    start = time.perf_counter()
    try:
        detections = solver.detect(image) if shared is None else shared
        detect_ms = 1000.0 * (time.perf_counter() - start)
        uv, flux = points_of(detections)
        check_points(uv, flux)
    except Exception as error:  # a contestant may raise anything
        return failure(error, 1000.0 * (time.perf_counter() - start), shared)
    start = time.perf_counter()
    try:
        answer = solver.solve(detections, frame.observation)
        check_answer(answer, len(uv))
        status = FIX if answer.ok else REFUSED
    except Exception as error:  # a contestant may raise anything
        answer, status = failure(error, 0.0).answer, ERROR
    solve_ms = 1000.0 * (time.perf_counter() - start)
    return Response(answer, status, uv, flux, detect_ms, solve_ms, peak_mib() if known else None)


class OtherProcessSession:
    """A Python object in a separate process, to which it is sent; it must be picklable."""

    def __init__(self, solver: SolverUnderTest) -> None:
        self._solver = solver
        self._process: ProcessPoolExecutor | None = None

    def start(self) -> str:
        """Start the process, and wait until it holds the object. Raises SolverError."""
        self._ready()
        return self._solver.version

    def answer(self, frame: Frame, shared: Detections | None) -> Response:
        """Ask the object in its process; if it ends the process, a new one is started for the next frame.

        Raises SolverError where a process does not get as far as the object.
        """
        process = self._ready()
        started = time.perf_counter()
        try:
            return process.submit(_answer_in_process, frame, shared).result()
        except BrokenProcessPool:
            self.close()
            return failure("error: ended its process", 1000.0 * (time.perf_counter() - started), shared)

    def _ready(self) -> ProcessPoolExecutor:
        """The process that holds the object."""
        if self._process is None:
            self._process = ProcessPoolExecutor(1, get_context("spawn"), _hold_in_process, (self._solver,))
            try:
                self._process.submit(_nothing).result()
            except BrokenProcessPool as error:
                self.close()
                raise SolverError(
                    f"{self._solver.name}: its process ended before it held the object: it imports the script and the "
                    'object\'s class again; run the engine under `if __name__ == "__main__":`, with the class in a module '
                    "that can be imported, or use jobs=1 (docs/benchmark.md)"
                ) from error
        return self._process

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.shutdown(wait=True, cancel_futures=True)
        self._process = None


# One session per process: an executor offers no other place for a process's state.
_session_of_process: list[InProcessSession] = []


def _hold_in_process(solver: SolverUnderTest) -> None:
    follow_parent()
    _session_of_process[:] = [InProcessSession(solver)]


def _nothing() -> None:
    """Done as soon as the process is there."""


def _answer_in_process(frame: Frame, shared: Detections | None) -> Response:
    return _session_of_process[0].answer(frame, shared)


class SessionPool:
    """Sessions of one solver, as many as the frames that are solved in parallel.

    Raises
    ------
    SolverError
        The solver cannot be started here.
    """

    def __init__(self, make_session: Callable[[], Session], jobs: int) -> None:
        self.jobs = jobs
        self._sessions = [make_session() for _ in range(jobs)]
        self._idle: queue.LifoQueue[Session] = queue.LifoQueue()
        for session in self._sessions:
            self._idle.put(session)
        try:
            # The session returned last is used first; the others start when they are needed.
            self.version = self._sessions[-1].start()
        except SolverError:
            self.close()
            raise

    @contextmanager
    def idle_session(self) -> Iterator[Session]:
        """Borrow a session that nobody else uses in the meantime."""
        session = self._idle.get()
        try:
            yield session
        finally:
            self._idle.put(session)

    def close(self) -> None:
        """End all sessions."""
        for session in self._sessions:
            session.close()


@contextmanager
def session_pool(make_session: Callable[[], Session], jobs: int) -> Iterator[SessionPool]:
    """Start a solver, and end it in any case.

    Raises
    ------
    SolverError
        It cannot be started here.
    """
    pool = SessionPool(make_session, jobs)
    try:
        yield pool
    finally:
        pool.close()
