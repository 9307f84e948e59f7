"""Commands for solvers that run elsewhere: `skybench bench pack-test`, `check` and `score`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmark.cli_errors import fail
from benchmark.errors import BenchmarkError
from benchmark.submission import Checked, Problem, check_answers, check_stars

EXIT_PROBLEMS = 1
MOST_PRINTED = 100

_File = Annotated[Path, typer.Argument(metavar="FILE", help="The answers: CSV or Parquet (docs/submissions.md).")]
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
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Dataset folder, truth included.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the set, empty or new.")],
) -> None:
    """Write DIR's images and what a solver may know, without the truth, under names that tell nothing."""
    from benchmark.submission_pack import opened, pack

    try:
        with opened(folder) as dataset, _progress() as progress:
            task = progress.add_task("packing", total=len(dataset.frames))
            pack(dataset.frames, out, lambda name: progress.advance(task))
            count = len(dataset.frames)
    except BenchmarkError as error:
        fail(error)
    typer.echo(
        f"{count} frames in {out}; fill in {out}/answers.csv, then: skybench bench check {out}/answers.csv --set {out}"
    )


def check(
    file: _File,
    stars: _Stars = None,
    packed: Annotated[Path | None, typer.Option("--set", help="The set that was answered, to check ids.")] = None,
) -> None:
    """Say line by line what is wrong with a submission."""
    from benchmark.submission_pack import listed_names

    try:
        names = None if packed is None else listed_names(packed)
    except BenchmarkError as error:
        fail(error)
    answers = _read(file, stars, names)[0]
    fixes = sum(answer.status == "fix" for answer in answers.answers)
    typer.echo(f"in order: {len(answers.answers)} frames, {fixes} fixes")


def score(
    file: _File,
    truth: Annotated[Path, typer.Option("--truth", help="Dataset folder that the set was packed from.")],
    name: Annotated[str, typer.Option("--name", help="Name on the leaderboard.")],
    stars: _Stars = None,
    out: Annotated[Path, typer.Option("--out", help="Results folder.")] = Path("results/demo"),
) -> None:
    """Score a submission and put it beside the results of the solvers that ran here."""
    from benchmark.formatting import number, percent
    from benchmark.submission_pack import opened
    from benchmark.submission_score import check_name, judge_submission, names_in_use, version_of, write_dataset_result

    try:
        check_name(name)
        with opened(truth) as dataset, Console(stderr=True).status("scoring"):
            names = names_in_use(dataset.frames, [answer.frame_id for answer in check_answers(file).answers])
            answers, table = _read(file, stars, frozenset(names.values()))
            outcomes = judge_submission(dataset.frames, names, answers, table)
            summary = write_dataset_result(dataset, out, name, version_of(file, stars), outcomes)
    except BenchmarkError as error:
        fail(error)
    typer.echo(
        f"{name}: {summary.n_frames} frames, {summary.n_fixes} fixes, {percent(summary.recall.value)} within 10 km, "
        f"median error {number(summary.median_error_km.value, 'km')}"
    )
    typer.echo(f"results in {out}; next: skybench bench report --out {out}")


def _read(file: Path, stars: Path | None, names: frozenset[str] | None) -> tuple[Checked, Checked | None]:
    """Read both files; print what is wrong and exit where anything is."""
    answers = check_answers(file, names)
    table = None if stars is None else check_stars(stars, names)
    for path, checked in ((file, answers), (stars, table)):
        if checked is not None and path is not None:
            _print(path, checked.problems)
    if answers.problems or (table is not None and table.problems):
        raise typer.Exit(EXIT_PROBLEMS)
    return answers, table


def _print(path: Path, problems: tuple[Problem, ...]) -> None:
    for problem in problems[:MOST_PRINTED]:
        typer.echo(f"{path}: {problem}", err=True)
    if len(problems) > MOST_PRINTED:
        typer.echo(f"{path}: and {len(problems) - MOST_PRINTED} more problems", err=True)


def _progress() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True))
