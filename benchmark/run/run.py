"""Running solvers over a dataset and judging their answers."""

import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmark import provenance
from benchmark.errors import DatasetError, ResultsError
from benchmark.frames.conditions import site_of
from benchmark.frames.dataset import Dataset, Frame, load_image, open_dataset
from benchmark.frames.preview import preview_webp
from benchmark.judge.frame_bounds import bound_of
from benchmark.judge.geodesy import east_north_km, geodesic_km
from benchmark.judge.star_id import score_matches
from benchmark.protocol import Answer, Detections, SolverUnderTest
from benchmark.run.result_tables import DetectionRow, FrameDetails, finite, match_table
from benchmark.run.results import (
    PREVIEW_FOLDER,
    ResultFiles,
    RunProvenance,
    check_room,
    check_solver_name,
    write_atomically,
    write_result,
)
from benchmark.solvers.memory import peak_mib, reset_peak
from benchmark.solvers.registry import make_solver
from benchmark.stats.metrics import ERROR, FIX, REFUSED, FrameScore, Summary, summarise

_MAX_REASON = 200


@dataclass(frozen=True)
class SolverOutcome:
    """One solver's judged answer on one frame, with what the results record beside the score."""

    score: FrameScore
    details: FrameDetails
    detections: tuple[DetectionRow, ...]


@dataclass(frozen=True)
class FrameOutcome:
    """All solvers' outcomes on one frame, and its preview picture (WebP)."""

    frame_id: str
    solvers: tuple[SolverOutcome, ...]
    preview: bytes


def run_benchmark(
    folder: Path,
    solvers: Sequence[str | SolverUnderTest],
    out: Path,
    jobs: int = 1,
    progress: bool = True,
) -> dict[str, Summary]:
    """Run solvers over all frames of a dataset, judge them and write the results.

    A solver that raises, or whose answer makes no sense, is scored as refusing that frame with status ``error``.
    Nothing is written before all frames are done.

    Parameters
    ----------
    folder : Path
        Dataset folder.
    solvers : sequence of str or SolverUnderTest
        Names known to the registry, or contestants themselves.
    out : Path
        Results folder, made if missing.
    jobs : int
        Processes; with more than one, times per frame include what they take from each other.
    progress : bool
        Show a progress bar on the terminal.

    Returns
    -------
    dict of str to Summary
        By solver, in the order given.

    Raises
    ------
    UnknownSolverError, DatasetError, ResultsError
        See there; raised before any frame is solved, except for a damaged image.
    """
    contestants = tuple(make_solver(solver) if isinstance(solver, str) else solver for solver in solvers)
    names = [contestant.name for contestant in contestants]
    for name in names:
        check_solver_name(name)
    if not names or len(set(names)) != len(names):
        raise ResultsError(f"give each solver once and at least one, found {', '.join(names) or 'none'}")
    if jobs < 1:
        raise ResultsError(f"jobs must be at least 1, found {jobs}")
    dataset = open_dataset(folder)
    missing = [frame.image_path for frame in dataset.frames if not frame.image_path.is_file()]
    if missing:
        raise DatasetError(f"{missing[0]}: missing image; render the dataset again with `skybench render`")
    check_room(out, names, dataset.scenario_sha256, dataset.truth_sha256)
    outcomes = list(_with_progress(_outcomes(dataset, contestants, jobs), len(dataset.frames), progress))
    for outcome in outcomes:
        write_atomically(out / PREVIEW_FOLDER / f"{outcome.frame_id}.webp", outcome.preview)
    summaries = {}
    for place, contestant in enumerate(contestants):
        mine = [outcome.solvers[place] for outcome in outcomes]
        scores = [outcome.score for outcome in mine]
        write_result(
            ResultFiles.beside(out, contestant.name),
            contestant.name,
            scores,
            [outcome.details for outcome in mine],
            match_table([row for outcome in mine for row in outcome.detections]),
            _provenance(dataset, contestant, jobs),
        )
        summaries[contestant.name] = summarise(scores)
    return summaries


def judge_frame(
    frame: Frame, image: NDArray[np.uint16], solvers: Sequence[SolverUnderTest], warm_up: bool = False
) -> tuple[SolverOutcome, ...]:
    """Run and judge all solvers on one frame, detection once per detector.

    Parameters
    ----------
    frame : Frame
        Its `observation` and the image are all that a solver gets.
    image : ndarray of uint16, shape (height, width)
        DN.
    solvers : sequence of SolverUnderTest
    warm_up : bool
        Answer once without the clock first, so that one-off loading of tables does not count as solving.
    """
    if warm_up:
        judge_frame(frame, image, solvers)
    found: dict[str, tuple[Detections | Exception, float]] = {}
    outcomes = []
    bound_km = bound_of(frame)
    for solver in solvers:
        known = reset_peak()
        if solver.detector not in found:
            found[solver.detector] = _detect(solver, image)
        detections, detect_ms = found[solver.detector]
        start = time.perf_counter()
        if isinstance(detections, Exception):
            answer, status = _refusal(detections), ERROR
            uv, flux = np.empty((0, 2)), np.empty(0)
        else:
            uv, flux = _points(detections)
            answer, status = _solve(solver, detections, frame, len(uv))
        solve_ms = 1000.0 * (time.perf_counter() - start)
        memory_mib = peak_mib() if known else None
        outcomes.append(judge_answer(frame, answer, status, uv, flux, detect_ms, solve_ms, memory_mib, bound_km))
    return tuple(outcomes)


def _points(detections: Detections) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Copy positions and fluxes, so that the solver cannot change what is judged; NaN for unknown flux."""
    uv = np.array(detections.uv, dtype=np.float64)
    flux = np.full(len(uv), np.nan) if detections.flux is None else np.array(detections.flux, dtype=np.float64)
    return uv, flux


def _detect(solver: SolverUnderTest, image: NDArray[np.uint16]) -> tuple[Detections | Exception, float]:
    # A copy that cannot be written to: no solver may change what the next one sees.
    image = image.copy()
    image.flags.writeable = False
    start = time.perf_counter()
    try:
        detections = solver.detect(image)
        elapsed = 1000.0 * (time.perf_counter() - start)
        uv, flux = _points(detections)
        if uv.ndim != 2 or uv.shape[1] != 2 or flux.shape != (len(uv),) or not np.isfinite(uv).all():
            raise ValueError(f"detections of shapes {uv.shape} and {flux.shape}, or not finite")
    except Exception as error:  # a contestant may raise anything
        return error, 1000.0 * (time.perf_counter() - start)
    return detections, elapsed


def _solve(solver: SolverUnderTest, detections: Detections, frame: Frame, n: int) -> tuple[Answer, str]:
    try:
        answer = solver.solve(detections, frame.observation)
        check_answer(answer, n)
    except Exception as error:  # a contestant may raise anything
        return _refusal(error), ERROR
    return answer, FIX if answer.ok else REFUSED


def check_answer(answer: Answer, n_detections: int) -> None:
    """Refuse an answer that cannot be scored.

    Raises
    ------
    ValueError
        A fix without a possible position; matches that are not (m, 2) integers, point to no detection or to one
        twice; a covariance that is not 2x2, finite and symmetric; a confidence beyond 0 to 1.
    """
    if answer.ok:
        lat, lon = answer.lat_deg, answer.lon_deg
        if lat is None or lon is None or not (math.isfinite(lat) and math.isfinite(lon)) or abs(lat) > 90.0:
            raise ValueError(f"fix at impossible position ({lat}, {lon})")
    matches = answer.matches
    if matches.ndim != 2 or matches.shape[1] != 2 or not np.issubdtype(matches.dtype, np.integer):
        raise ValueError(f"matches of shape {matches.shape} and type {matches.dtype}")
    claimed = matches[:, 0]
    if len(claimed) and (claimed.min() < 0 or claimed.max() >= n_detections):
        raise ValueError("a match points to no detection")
    if len(np.unique(claimed)) != len(claimed):
        raise ValueError("a detection is matched twice")
    cov = answer.cov_km2
    if cov is not None and not (cov.shape == (2, 2) and np.isfinite(cov).all() and np.allclose(cov, cov.T)):
        raise ValueError("covariance is not a finite symmetric 2x2 matrix")
    if answer.confidence is not None and not 0.0 <= answer.confidence <= 1.0:
        raise ValueError(f"confidence {answer.confidence} is not within 0 to 1")


def _refusal(error: Exception) -> Answer:
    text = " ".join(f"error: {type(error).__name__}: {error}".split())
    return Answer(ok=False, reason=text[:_MAX_REASON])


def judge_answer(
    frame: Frame,
    answer: Answer,
    status: str,
    uv: NDArray[np.float64],
    flux: NDArray[np.float64],
    detect_ms: float,
    solve_ms: float,
    peak_memory_mib: float | None,
    crlb_km: float | None,
) -> SolverOutcome:
    """Hold an answer that `check_answer` has let pass against the frame's truth.

    Parameters
    ----------
    frame : Frame
    answer : Answer
    status : str
        ``fix``, ``refused`` or ``error``.
    uv : ndarray, shape (n, 2)
        Detections that the answer's matches point to, px.
    flux : ndarray, shape (n,)
        Their brightness, NaN where unknown.
    detect_ms, solve_ms : float
    peak_memory_mib : float or None
    crlb_km : float or None
        The frame's bound, see `benchmark.judge.frame_bounds`.
    """
    conditions = frame.conditions
    error_km = math.inf
    lat_deg = lon_deg = east_km = north_km = None
    if answer.ok and answer.lat_deg is not None and answer.lon_deg is not None:
        lat_deg, lon_deg = answer.lat_deg, answer.lon_deg
        places = conditions.latitude_deg, conditions.longitude_deg, lat_deg, lon_deg
        error_km = geodesic_km(*places)
        east_km, north_km = east_north_km(*places)
    # A refused frame claims nothing, whatever the solver may have had in hand.
    matches = answer.matches if answer.ok else np.empty((0, 2), dtype=np.int64)
    stars = score_matches(uv, matches, frame.truth)
    claims = {
        int(detection): (int(star), bool(right))
        for (detection, star), right in zip(matches, stars.correct, strict=True)
    }
    rows = tuple(
        DetectionRow(frame.frame_id, i, float(u), float(v), finite(flux[i]), *claims.get(i, (None, None)))
        for i, (u, v) in enumerate(uv)
    )
    score = FrameScore(
        frame_id=frame.frame_id,
        index=frame.index,
        bortle=conditions.bortle,
        width_px=frame.observation.camera.width,
        height_px=frame.observation.camera.height,
        status=status,
        reason=answer.reason if not answer.ok else "",
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        error_km=error_km,
        n_detections=len(uv),
        n_detected_stars=stars.n_detected_stars,
        n_matches=stars.n_matches,
        n_correct=stars.n_correct,
        time_ms=detect_ms + solve_ms,
    )
    cov = answer.cov_km2 if answer.ok else None
    details = FrameDetails(
        cov_km2=None if cov is None else (float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])),
        confidence=answer.confidence,
        detect_ms=detect_ms,
        solve_ms=solve_ms,
        stage_ms=dict(answer.time_ms),
        utc=frame.observation.utc,
        conditions=conditions,
        condition=frame.condition,
        site=site_of(conditions.latitude_deg, conditions.longitude_deg, frame.observation.utc),
        error_east_km=east_km,
        error_north_km=north_km,
        crlb_km=crlb_km,
        peak_memory_mib=peak_memory_mib,
    )
    return SolverOutcome(score, details, rows)


@dataclass
class _Worker:
    """A process's contestants, and whether it has answered a frame yet."""

    solvers: tuple[SolverUnderTest, ...]
    warm: bool = False

    def work(self, frame: Frame) -> FrameOutcome:
        image = load_image(frame)
        outcomes = judge_frame(frame, image, self.solvers, warm_up=not self.warm)
        self.warm = True
        return FrameOutcome(frame.frame_id, outcomes, preview_webp(image))


# One worker per process: an executor offers no other place for what a process keeps.
_worker_of_process: list[_Worker] = []


def _start_process(solvers: tuple[SolverUnderTest, ...]) -> None:
    _worker_of_process[:] = [_Worker(solvers)]


def _work_in_process(frame: Frame) -> FrameOutcome:
    return _worker_of_process[0].work(frame)


def _outcomes(dataset: Dataset, solvers: tuple[SolverUnderTest, ...], jobs: int) -> Iterator[FrameOutcome]:
    if jobs == 1:
        worker = _Worker(solvers)
        yield from map(worker.work, dataset.frames)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_start_process, initargs=(solvers,)) as pool:
        try:
            yield from pool.map(_work_in_process, dataset.frames)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _with_progress(outcomes: Iterator[FrameOutcome], total: int, show: bool) -> Iterator[FrameOutcome]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("frames"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), disable=not show) as bar:
        task = bar.add_task("solving", total=total)
        for outcome in outcomes:
            yield outcome
            bar.advance(task)


def _provenance(dataset: Dataset, solver: SolverUnderTest, jobs: int) -> RunProvenance:
    return RunProvenance(
        dataset=dataset.name,
        scenario_name=dataset.scenario_name,
        scenario_sha256=dataset.scenario_sha256,
        truth_sha256=dataset.truth_sha256,
        dataset_provenance=dataset.provenance,
        solver_version=solver.version,
        detector=solver.detector,
        versions=provenance.versions(),
        machine=provenance.machine(),
        date_utc=provenance.now_utc(),
        jobs=jobs,
    )
