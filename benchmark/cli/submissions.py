"""Commands for solvers that run elsewhere: `skybench bench pack-test`, `check` and `score`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import progress_bars
from benchmark.errors import BenchmarkError

if TYPE_CHECKING:
    from rich.progress import Progress

    from benchmark.frames.frame_set import FrameFacts, FrameSet
    from benchmark.submit.submission import Checked, Problem

EXIT_PROBLEMS = 1
MOST_PRINTED = 100


class Split(StrEnum):
    """The two sets of a task's frames."""

    DEV = "dev"
    TEST = "test"


_File = Annotated[Path, typer.Argument(metavar="FILE", help="The answers: CSV or Parquet (docs/submissions.md).")]
_Target = Annotated[
    str,
    typer.Argument(
        metavar="TASK|DIR",
        help="Task (see `bench list`) or its file; folder or URL of frames.",
        autocompletion=completion.targets,
    ),
]
_SplitOption = Annotated[Split, typer.Option("--split", help="Of the task.")]
_Frames = Annotated[
    int | None,
    typer.Option("--frames", min=1, help="Frames a condition, the same for packing and scoring; default: all."),
]
_Data = Annotated[Path, typer.Option("--data", help="Folder for the tasks' frames; missing ones are rendered.")]
_Jobs = Annotated[int, typer.Option("--jobs", min=1, help="Processes that render.")]
_DEFAULT_DATA = Path("out/tasks")
_Stars = Annotated[Path | None, typer.Option("--stars", help="Star table of the submission, CSV or Parquet.")]


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("pack-test", epilog="Example: skybench bench pack-test out/demo --out out/set")(pack_test)
    app.command(
        "check", epilog="Example: skybench bench check answers.csv --set out/set. Exit status: 0 in order, 1 not."
    )(check)
    app.command(
        "score", epilog="Example: skybench bench score answers.csv --truth out/demo --name mine --out results/demo"
    )(score)


def pack_test(
    target: _Target,
    out: Annotated[Path, typer.Option("--out", help="Folder for the set, empty or new.")],
    split: _SplitOption = Split.TEST,
    frames: _Frames = None,
    data: _Data = _DEFAULT_DATA,
    jobs: _Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """Write images with the records that a solver may use, without the truth, under names that reveal nothing."""
    from benchmark.submit.pack import pack  # loads the solvers, for which --help need not wait

    try:
        with progress_bars() as progress:
            truth = _opened(target, split, frames, data, jobs, progress)
            task = progress.add_task("packing", total=len(truth.frames))
            pack(truth.frames, out, lambda name: progress.advance(task))
            count = len(truth.frames)
    except BenchmarkError as error:
        fail(error)
    form = out / "answers.csv"
    if as_json:
        print_json({"out": out, "frames": count, "answers": form})
        return
    typer.echo(f"{count} frames in {out}; fill in {form}, then: skybench bench check {form} --set {out}")


def check(
    file: _File,
    stars: _Stars = None,
    packed: Annotated[Path | None, typer.Option("--set", help="The set that was answered, to check ids.")] = None,
    as_json: AsJson = False,
) -> None:
    """Report the faults of a submission line by line."""
    from benchmark.submit.pack import listed_names

    try:
        names = None if packed is None else listed_names(packed)
    except BenchmarkError as error:
        fail(error)
    answers, table = _read(file, stars, names, as_json)
    if as_json:
        print_json(_document(file, stars, answers, table))
        return
    fixes = _fixes(answers)
    hint = "" if packed else "; with --set SET, ids and missing frames are checked too"
    typer.echo(f"in order: {len(answers.answers)} frames, {fixes} fixes{hint}")


def score(
    file: _File,
    truth: Annotated[
        str,
        typer.Option(
            "--truth",
            metavar="TASK|DIR",
            help="Task or dataset that the set was packed from.",
            autocompletion=completion.targets,
        ),
    ],
    name: Annotated[str, typer.Option("--name", help="Name on the leaderboard.")],
    stars: _Stars = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Results folder; default results/leaderboard or results/demo.")
    ] = None,
    split: _SplitOption = Split.TEST,
    frames: _Frames = None,
    data: _Data = _DEFAULT_DATA,
    jobs: _Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """Score a submission and store it next to the results of the solvers that ran here."""
    from benchmark.report.formatting import number, percent
    from benchmark.stats.frame_metrics import success_limit_km
    from benchmark.stats.metrics import summarise
    from benchmark.submit.score import check_name, judge_submission, names_in_use, version_of, write_score

    try:
        check_name(name)
        answers, _ = _read(file, stars, None, as_json)  # rendering takes hours
        with progress_bars() as progress:
            found = _opened(truth, split, frames, data, jobs, progress)
            names = names_in_use(found.frames, [answer.frame_id for answer in answers.answers])
            answers, table = _read(file, stars, frozenset(names.values()), as_json)
            outcomes = judge_submission(found.frames, names, answers, table)
            folder = out or default_out(found.facts)
            path = write_score(found, folder, name, version_of(file, stars), outcomes)
    except BenchmarkError as error:
        fail(error)
    limit_km = success_limit_km(found.facts.metric)
    summary = summarise([outcome.score for outcome in outcomes], limit_km)
    if as_json:
        print_json({"solver": name, "folder": path, "limit_km": limit_km, "summary": summary})
        return
    typer.echo(
        f"{name}: {summary.n_frames} frames, {summary.n_fixes} fixes, "
        f"{percent(summary.recall.value)} within {limit_km:.4g} km, "
        f"median error {number(summary.median_error_km.value, 'km')}"
    )
    typer.echo(f"results in {path}; next: skybench bench report --out {folder}")


def default_out(frames: FrameFacts) -> Path:
    """Default folder of results: the leaderboard for skybench's own tasks, the demonstration's for other frames."""
    return Path("results/demo" if frames.grading is None else "results/leaderboard")


def _opened(target: str, split: Split, frames: int | None, data: Path, jobs: int, progress: Progress) -> FrameSet:
    from benchmark.frames.opening import open_frames
    from benchmark.frames.task_frames import FrameChoice

    line = progress.add_task("frames", total=None, visible=False)

    def advance(count: int) -> None:
        progress.update(line, advance=count, visible=True)

    found = open_frames(target, FrameChoice(split.value, frames, None, data, jobs), advance)
    progress.update(line, visible=False)
    return found


def _read(
    file: Path, stars: Path | None, names: frozenset[str] | None, as_json: bool
) -> tuple[Checked, Checked | None]:
    """Read both files; print their problems and exit if there are any."""
    from benchmark.submit.submission import check_answers, check_stars

    answers, table = check_answers(file, names), None if stars is None else check_stars(stars, names)
    if not answers.problems and (table is None or not table.problems):
        return answers, table
    if as_json:
        print_json(_document(file, stars, answers, table))
    else:
        for path, checked in ((file, answers), (stars, table)):
            if checked is not None and path is not None:
                _print(path, checked.problems)
    raise typer.Exit(EXIT_PROBLEMS)


def _document(file: Path, stars: Path | None, answers: Checked, table: Checked | None) -> dict[str, object]:
    """The content read from both files and all their problems."""
    found = [(file, answers.problems), *([] if table is None or stars is None else [(stars, table.problems)])]
    problems = [{"file": path} | vars(problem) for path, listed in found for problem in listed]
    return {
        "in_order": not problems,
        "frames": len(answers.answers),
        "fixes": _fixes(answers),
        "problems": problems,
    }


def _fixes(answers: Checked) -> int:
    return sum(answer.status == "fix" for answer in answers.answers)


def _print(path: Path, problems: tuple[Problem, ...]) -> None:
    for problem in problems[:MOST_PRINTED]:
        typer.echo(f"{path}: {problem}", err=True)
    if len(problems) > MOST_PRINTED:
        typer.echo(f"{path}: and {len(problems) - MOST_PRINTED} more problems", err=True)
