"""Commands `skybench bench round draw`, `pack`, `score`, `open` and `verify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.choices import DetectionsChoice
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import progress_bars
from benchmark.errors import BenchmarkError, RoundError

app = typer.Typer(
    help="Frames that a secret draws after the solvers are settled, and that are opened afterwards (docs/rounds.md).",
    no_args_is_help=True,
)

_Round = Annotated[Path, typer.Argument(metavar="ROUND", help="The round's folder, which is published.")]
_Secret = Annotated[Path, typer.Option("--secret", help="File of the secret: 32 hexadecimal digits.")]
_Truth = Annotated[Path, typer.Option("--truth", help="Private folder of the frames with their truth.")]
_Beacon = Annotated[str, typer.Option("--beacon", help="Value of the public random number that the commitment names.")]
_Jobs = Annotated[int, typer.Option("--jobs", min=1, help="Processes that render.")]


@app.command(epilog="Example: skybench bench round draw --secret secret.hex --solver skybench --out rounds/first")
def draw(
    secret: Annotated[Path, typer.Option("--secret", help="File for the secret, new; readable by you alone.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the round, new; all in it is to be published.")],
    rules: Annotated[
        str, typer.Option("--rules", help="Rules by their file, or the name of those of skybench.")
    ] = "open-sky",
    frames: Annotated[int, typer.Option("--frames", min=1, help="How many.")] = 500,
    name: Annotated[str | None, typer.Option("--name", help="Of the round; default: the folder's.")] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option("--solver", help="Solver whose revision is settled; repeat.", autocompletion=completion.solvers),
    ] = None,
    entrant: Annotated[
        list[str] | None,
        typer.Option("--entrant", metavar="NAME=HASH", help="Who submits answers, and a hash of the program; repeat."),
    ] = None,
    beacon: Annotated[
        str, typer.Option("--beacon", help="In words, a public random number of a later time that goes into the draw.")
    ] = "",
    as_json: AsJson = False,
) -> None:
    """Commit to a secret, the rules and the contestants' revisions, before any frame exists."""
    from benchmark.cli.rounds.contestants import settled
    from benchmark.rounds.commitment import COMMITMENT
    from benchmark.rounds.rules import load_rules
    from benchmark.rounds.secret import secret_for
    from benchmark.rounds.steps import check_apart, commit

    try:
        found = load_rules(rules)
        contestants = settled(solver or [], entrant or [])
        check_apart(secret, {"the round": out})
        with secret_for(out / COMMITMENT, secret) as number:
            committed = commit(out, number, found, name or out.resolve().name, frames, contestants, beacon)
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"out": out, "commitment_sha256": committed.sha256, "frames": frames, "contestants": contestants})
        return
    typer.echo(f"{out}: commitment {committed.sha256}")
    typer.echo(
        f"publish {out} before anything else, keep {secret} to yourself; next: skybench bench round pack {out} "
        f"--secret {secret} --truth FOLDER --out SET"
    )


@app.command(
    epilog="Example: skybench bench round pack rounds/first --secret secret.hex --truth private/first --out sets/first"
)
def pack(
    folder: _Round,
    secret: _Secret,
    truth: _Truth,
    out: Annotated[Path, typer.Option("--out", help="Folder for the set that solvers get, empty or new.")],
    beacon: _Beacon = "",
    jobs: _Jobs = 1,
    as_json: AsJson = False,
) -> None:
    """Draw and render the frames, and write the set for solvers: images and instrument readings, without the truth."""
    from benchmark.rounds.secret import read_secret
    from benchmark.rounds.steps import draw as draw_round
    from benchmark.rounds.steps import pack_round

    try:
        drawn = draw_round(folder, read_secret(secret), beacon)
        with progress_bars() as progress:
            task = progress.add_task("rendering", total=len(drawn.frames))
            count = pack_round(folder, drawn, truth, out, jobs, lambda frames: progress.advance(task, frames))
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"out": out, "frames": count})
        return
    typer.echo(
        f"{count} frames in {out}; next: skybench bench round score {folder} --secret {secret} --truth {truth} --set {out} "
        "--solver NAME"
    )


@app.command(
    epilog="Examples: skybench bench round score rounds/first --secret secret.hex --truth private/first --set sets/first "
    "--solver skybench | … --answers answers.csv --name theirs"
)
def score(
    folder: _Round,
    secret: _Secret,
    truth: _Truth,
    packed: Annotated[Path, typer.Option("--set", help="The set that `pack` wrote.")],
    solver: Annotated[
        list[str] | None,
        typer.Option("--solver", help="Solver to run and score; repeat.", autocompletion=completion.solvers),
    ] = None,
    answers: Annotated[
        Path | None, typer.Option("--answers", help="Submitted answers (docs/submissions.md), in place of --solver.")
    ] = None,
    stars: Annotated[Path | None, typer.Option("--stars", help="Star table of the answers.")] = None,
    name: Annotated[str | None, typer.Option("--name", help="Of who submits the answers.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Results folder; default: ROUND/results, of --later ROUND/later.")
    ] = None,
    later: Annotated[
        bool, typer.Option("--later", help="Of a solver that was not settled before the draw: kept apart.")
    ] = False,
    detections: Annotated[
        DetectionsChoice,
        typer.Option("--detections", help="own: each solver detects by itself; shared: all get the same."),
    ] = DetectionsChoice.OWN,
    beacon: _Beacon = "",
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Frames to solve at the same time.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Score solvers run on the set, or answers to it; solvers must be unchanged since the commitment."""
    if bool(solver) == bool(answers) or bool(answers) != bool(name):
        fail(RoundError("give --solver, or --answers and --name"))
    from benchmark.cli.rounds.scoring import Scoring, score_answers, score_solvers
    from benchmark.rounds.private_frames import LATER
    from benchmark.rounds.scored_answers import RESULTS
    from benchmark.rounds.secret import read_secret
    from benchmark.rounds.steps import draw as draw_round

    try:
        place = out or folder / (LATER if later else RESULTS)
        wanted = Scoring(folder, draw_round(folder, read_secret(secret), beacon), truth, packed, place, later)
        if answers is not None and name is not None:
            found = [score_answers(wanted, answers, stars, name)]
        else:
            found = score_solvers(wanted, solver or [], detections.value, jobs)
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"out": wanted.out, "results": [vars(one) for one in found]})
        return
    for one in found:
        typer.echo(one.words)
    typer.echo(
        f"next: skybench bench report --out {wanted.out}; before you publish it, pack its raw results into tables: "
        f"skybench bench pack-results --out {wanted.out}"
    )


@app.command("open", epilog="Example: skybench bench round open rounds/first --secret secret.hex --truth private/first")
def open_(folder: _Round, secret: _Secret, truth: _Truth, beacon: _Beacon = "", as_json: AsJson = False) -> None:
    """Publish the secret and the hashes of all frames, once all answers are in."""
    from benchmark.rounds.secret import read_secret
    from benchmark.rounds.steps import draw as draw_round
    from benchmark.rounds.steps import open_round

    try:
        number = read_secret(secret)
        path = open_round(folder, number, draw_round(folder, number, beacon), truth, beacon)
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json({"out": path})
        return
    typer.echo(f"{path}: anyone can check it with: skybench bench round verify {folder} --render 3")


@app.command(epilog="Example: skybench bench round verify rounds/first --render 3. Exit status: 0 as published, 2 not.")
def verify(
    folder: _Round,
    render: Annotated[int, typer.Option("--render", min=0, help="Frames to render again and compare.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Check that an opened round's secret is the one committed to, and that it draws what was published."""
    from benchmark.rounds.steps import verify_round

    try:
        with progress_bars() as progress:
            task = progress.add_task("rendering", total=render, visible=render > 0)
            found = verify_round(folder, render, lambda frames: progress.advance(task, frames))
    except BenchmarkError as error:
        fail(error)
    if as_json:
        print_json(vars(found))
        return
    typer.echo(
        f"{folder}: as published: commitment, rules, {found.frames} scenarios, {found.rendered} frames rendered again"
        + (", which make the set that solvers got" if found.whole_set else "")
    )
