"""`skybench bench run`: open frames, run or try solvers, and report the outcome."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import typer
from rich.progress import Progress

from benchmark.cli.output import print_json
from benchmark.cli.progress import progress_bars
from benchmark.errors import ResultsError
from benchmark.frames.dataset import Frame
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.opening import named_task, open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.judge.outcome import SolverOutcome
from benchmark.real_tasks.definition import is_real_task
from benchmark.report.formatting import number
from benchmark.run.contestants import Contestant, contestant_of
from benchmark.run.engine import SolverRun, check_contestants, check_sequences, outcomes, run_all
from benchmark.run.provenance import DetectionsMode
from benchmark.run.results import check_writable
from benchmark.run.sessions import session_pool
from benchmark.solvers.registry import solvers_by_themselves
from benchmark.stats.metrics import ERROR, FIX
from benchmark.tasks.definition import task_names

LEADERBOARD, DEMO, REAL = Path("results/leaderboard"), Path("results/demo"), Path("results/real")
PART = Path("results/part")
"""Place of results on a part of a task's frames, which no board can compare with those on all of them."""
ALL_ERRORS = 1


@dataclass(frozen=True)
class Request:
    """What the command line requests.

    Attributes
    ----------
    targets : sequence of str
        See `benchmark.frames.opening.open_frames`.
    solvers : sequence of str
        Names or folders; if empty, all that can run here.
    choice : FrameChoice
    detections : str
    out : Path or None
        None selects the place where such frames belong.
    jobs : int
    """

    targets: Sequence[str]
    solvers: Sequence[str]
    choice: FrameChoice
    detections: DetectionsMode
    out: Path | None
    jobs: int


def run_solvers(request: Request, tell: Callable[[str], None]) -> tuple[Path, list[SolverRun]]:
    """Run what is missing; return the folder of results and the runs.

    Parameters
    ----------
    request : Request
    tell : callable
        Called with a line about each solver that has finished.

    Raises
    ------
    BenchmarkError
        Frames or a solver do not exist, or cannot be used here.
    """
    contestants = check_contestants(_contestants(request.solvers), request.jobs)
    out = request.out or default_out(request.targets, request.choice)
    check_writable(out)
    runs: list[SolverRun] = []
    with progress_bars() as bar:
        sets = [_opened(bar, target, request.choice) for target in request.targets]
        check_sequences(contestants, sets)
        total = sum(len(one.frames) for one in sets)
        lines = {contestant.name: bar.add_task(contestant.name, total=total) for contestant in contestants}

        def advance(solver: str, count: int) -> None:
            bar.advance(lines[solver], count)

        for done in run_all(contestants, sets, out, request.detections, request.jobs, advance):
            runs.append(done)
            mine = [run for run in runs if run.solver == done.solver]
            if len(mine) == len(sets):
                tell(_words(mine))
    return out, runs


def run_request(request: Request, as_json: bool = False) -> int:
    """Run what is missing, and return the exit status: 1 where every answer of a solver on some frames is an error.

    The outcome is printed in words, or as one JSON document.

    Raises
    ------
    BenchmarkError
        Frames or a solver do not exist, or cannot be used here.
    """
    out, runs = run_solvers(request, _silent if as_json else typer.echo)
    if as_json:
        print_json({"out": out, "runs": runs})
    else:
        typer.echo(f"results in {out}; next: skybench bench report --out {out}")
    failed = [run for run in runs if run.failed_throughout]
    for run in failed:
        _cry(f"{run.solver}: every answer of {run.summary.n_frames} is an error ({run.folder})")
    return ALL_ERRORS if failed else 0


def try_request(request: Request, count: int, as_json: bool = False) -> int:
    """Put a few evenly spread frames to one solver, and show its answers and what it writes to standard error.

    Parameters
    ----------
    request : Request
    count : int
        Number of frames.
    as_json : bool
        Whether to print one document at the end instead of a line for each answer.

    Returns
    -------
    int
        Exit status: 1 where every answer is an error.
    """
    if len(request.solvers) != 1 or len(request.targets) != 1:
        raise ResultsError("--try puts the frames of one task or folder to one --solver")
    (contestant,) = check_contestants(_contestants(request.solvers), 1)
    target, choice = request.targets[0], request.choice
    task = named_task(target)
    if task is not None and choice.per_condition is None:
        values = 1 if choice.condition is not None else len(task.definition.condition.values)
        few = min(math.ceil(count / values), task.definition.frames_per_condition)
        choice = replace(choice, per_condition=few)
    with progress_bars() as bar:
        found = _opened(bar, target, choice)
    check_sequences([contestant], [found])
    frames = _spread(found.frames, count)
    scores = []
    with session_pool(partial(contestant.make_session, 1, _pass_on), 1) as pool:
        version = pool.version
        if not as_json:
            typer.echo(f"{contestant.name} {version} on {len(frames)} of {len(found.frames)} frames of {target}")
        for frame, outcome in zip(frames, outcomes(frames, pool, request.detections, {}), strict=True):
            scores.append(outcome.score)
            if not as_json:
                typer.echo(_answer(frame, outcome))
    counts = Counter(score.status for score in scores)
    if as_json:
        answers = [{"frame": frame.frame_id} | vars(score) for frame, score in zip(frames, scores, strict=True)]
        print_json({"solver": contestant.name, "version": version, "target": target, "answers": answers})
    else:
        refused = len(scores) - counts[FIX] - counts[ERROR]
        typer.echo(f"{counts[FIX]} fixes, {refused} refused, {counts[ERROR]} errors")
    if counts[ERROR] == len(scores):
        _cry(f"{contestant.name}: every answer is an error")
        return ALL_ERRORS
    return 0


def _silent(words: str) -> None:
    """Say nothing."""


def obstacles(names: Sequence[str]) -> dict[str, str]:
    """Solvers that cannot run here, with the reason and the remedy."""
    found = {name: contestant_of(name).obstacle() for name in names}
    return {name: obstacle for name, obstacle in found.items() if obstacle}


def _contestants(names: Sequence[str]) -> list[Contestant]:
    """Contestants with these names; without names, all non-fused solvers that can run here, reporting why others cannot."""
    if names:
        return [contestant_of(name) for name in names]
    left_out = obstacles(solvers_by_themselves())
    for obstacle in left_out.values():
        typer.echo(f"left out: {obstacle}", err=True)
    return [contestant_of(name) for name in solvers_by_themselves() if name not in left_out]


def default_out(targets: Sequence[str], choice: FrameChoice) -> Path:
    """Folder of results on these frames where the caller names none."""
    ours = all(target.partition("@")[0] in task_names() and not Path(target).is_dir() for target in targets)
    if all(is_real_task(target) for target in targets):
        return REAL
    if not ours:
        return DEMO
    return LEADERBOARD if choice.per_condition is None and choice.condition is None else PART


def _opened(bar: Progress, target: str, choice: FrameChoice) -> FrameSet:
    line = bar.add_task(f"frames of {target}", total=None)
    found = open_frames(target, choice, partial(bar.advance, line))
    bar.update(line, total=len(found.frames), completed=len(found.frames))
    return found


def _words(runs: Sequence[SolverRun]) -> str:
    """Describe one solver's runs in a line."""
    name, solved, seconds = runs[0].solver, sum(run.n_solved for run in runs), sum(run.seconds for run in runs)
    counts = [sum(getattr(run.summary, key) for run in runs) for key in ("n_fixes", "n_refused", "n_errors")]
    ended = f"{counts[0]} fixes, {counts[1]} refused, {counts[2]} errors"
    if not solved:
        return f"{name}: finished before; {ended}"
    return f"{name}: {solved} frames in {seconds:.0f} s, {solved / seconds:.1f} frames/s; {ended}"


def _answer(frame: Frame, outcome: SolverOutcome) -> str:
    score = outcome.score
    condition = "" if frame.condition is None else f" ({frame.condition:g})"
    reason = score.reason or "gives no reason"
    ended = f"fix, {number(score.error_km, 'km')} off" if score.status == FIX else f"{score.status}: {reason}"
    if score.reason.startswith(f"{score.status}:"):
        ended = score.reason
    return f"{frame.frame_id}{condition}: {ended}; {score.n_detections} detections, {number(score.time_ms, 'ms')}"


def _spread(frames: Sequence[Frame], count: int) -> list[Frame]:
    most = min(count, len(frames))
    if any(frame.observation.sequence for frame in frames):
        return list(frames[:most])  # a sequence must be complete
    return [frames[n * len(frames) // most] for n in range(most)]


def _pass_on(words: bytes) -> None:
    """Show what a program writes to standard error."""
    sys.stderr.write(words.decode("utf-8", "replace"))
    sys.stderr.flush()


def _cry(message: str) -> None:
    typer.secho(f"skybench: {message}", fg=typer.colors.RED, err=True)
