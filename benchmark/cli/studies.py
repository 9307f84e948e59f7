"""Commands `skybench study thesis`, `calibration`, `realism` and `independence`."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli import completion
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import progress_bars
from benchmark.errors import BenchmarkError

if TYPE_CHECKING:
    from rich.progress import TaskID

    from benchmark.studies.common.progress import StudyProgress

app = typer.Typer(help="Replicate published work, and study sources of error.", no_args_is_help=True)

DEFAULT_OUT = Path("results/studies/thesis")
DEFAULT_SITES = 100
CALIBRATION_OUT = Path("results/studies/calibration")
CALIBRATION_SITES, CALIBRATION_PICTURES, GRADIENT_FRAMES = 40, 12, 10
CALIBRATION_SCENARIO = Path("calibration_study")
REALISM_OUT = Path("results/studies/realism")
INDEPENDENCE_OUT, INDEPENDENCE_FRAMES = Path("results/studies/independence"), 40
INDEPENDENCE_FEWEST = 6
"""That of `benchmark.studies.independence.study`, for which --help need not wait."""
INDEPENDENCE_SCENARIO = Path("independence_study")
EXIT_BAD_INPUT = 2


@app.callback()
def _group() -> None:
    """Replicate published work, and study sources of error."""


@app.command(epilog="Example: skybench study thesis --frames 24")
def thesis(
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=2, help="Frames per limiting magnitude; the scenario's 200 if left out."),
    ] = None,
    dataset: Annotated[
        Path | None, typer.Option("--dataset", help="Frames rendered before; rendered now if left out.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for tables, figures and the page.")] = DEFAULT_OUT,
    scenario: Annotated[
        Path, typer.Option("--scenario", help="The thesis' sets.", autocompletion=completion.scenarios)
    ] = Path("thesis_mag"),
    work: Annotated[Path, typer.Option("--work", help="Folder for rendered frames.")] = Path("out/thesis_mag"),
    sites: Annotated[int, typer.Option("--sites", min=2, help="Sites of the frames without pictures.")] = DEFAULT_SITES,
    as_json: AsJson = False,
) -> None:
    """Run all variants of the thesis' solver on its sets, and compare the results with the thesis' own."""
    from benchmark.studies.thesis.study import (
        NUMBERS,
        PAGE,
        run_study,
    )  # loads the solvers, which --help need not wait for
    from generator.scenario.shipped import find_scenario

    if frames is not None and dataset is not None:
        typer.echo("skybench: --frames is for rendering; leave it out with --dataset", err=True)
        raise typer.Exit(EXIT_BAD_INPUT)
    command = _command(frames, dataset, sites)
    with _one_line_for_bad_input(), _bars() as progress:
        study = run_study(find_scenario(scenario), frames, dataset, work, out, sites, command, progress)
    _print_study((f"{answer.key:6} {answer.verdict}" for answer in study.answers), out / NUMBERS, out / PAGE, as_json)


@app.command(epilog="Example: skybench study calibration --sites 10 --pictures 4")
def calibration(
    sites: Annotated[
        int, typer.Option("--sites", min=2, help="Sites of the frames without pictures.")
    ] = CALIBRATION_SITES,
    pictures: Annotated[
        int, typer.Option("--pictures", min=1, help="Rendered frames of each kind.")
    ] = CALIBRATION_PICTURES,
    gradient: Annotated[
        int, typer.Option("--gradient", min=0, help="Frames whose camera is recovered by gradient; 0 leaves this out.")
    ] = GRADIENT_FRAMES,
    out: Annotated[Path, typer.Option("--out", help="Folder for tables, figures and the page.")] = CALIBRATION_OUT,
    scenario: Annotated[
        Path,
        typer.Option(
            "--scenario",
            help="Sites, instants, attitude and camera, of any lens model.",
            autocompletion=completion.scenarios,
        ),
    ] = CALIBRATION_SCENARIO,
    fault_sizes: Annotated[
        list[str] | None,
        typer.Option(
            "--sizes",
            metavar="FAULT=SIZE,SIZE…",
            help="Sizes of a fault instead of the usual ones; may be repeated: focal (%), centre (px), k1, projection (deg), "
            "tilt (deg), heading (deg), clock (s), refraction (deg of tilt), epoch (yr).",
        ),
    ] = None,
    work: Annotated[Path, typer.Option("--work", help="Folder for rendered frames.")] = Path("out/calibration"),
    as_json: AsJson = False,
) -> None:
    """Give a solver a wrong camera, attitude, clock or sky, and compare its error with the first-order prediction."""
    from benchmark.studies.calibration.chosen import check_gradient, check_sizes, read_sizes, subject_of
    from generator.scenario.file import load_scenario
    from generator.scenario.shipped import find_scenario

    # Invalid input is refused before the solvers and the renderer are loaded.
    with _one_line_for_bad_input():
        by_fault = read_sizes(fault_sizes or ())
        path = find_scenario(scenario)
        subject = subject_of(loaded := load_scenario(path))
        check_sizes(subject, by_fault)
        if gradient:
            check_gradient(loaded, subject)
    from benchmark.studies.calibration.study import NUMBERS, PAGE, Sizes, run_study

    chosen = (
        ("--sites", sites, CALIBRATION_SITES),
        ("--pictures", pictures, CALIBRATION_PICTURES),
        ("--gradient", gradient, GRADIENT_FRAMES),
    )
    words = ["skybench", "study", "calibration"]
    if scenario != CALIBRATION_SCENARIO:
        words += ["--scenario", str(scenario)]
    words += [word for name, n, usual in chosen if n != usual for word in (name, str(n))]
    words += [word for one in fault_sizes or () for word in ("--sizes", one)]
    command = shlex.join(words)
    with _one_line_for_bad_input(), _bars() as progress:
        study = run_study(path, Sizes(sites, pictures, gradient), work, out, command, progress, by_fault)
    _print_study((f"{row[0]}: {row[6]}" for row in study.tables[0].rows), out / NUMBERS, out / PAGE, as_json)


@app.command(
    epilog="Example: skybench study realism nights/00[1356].fits.bz2 --calibrate-on nights/008.fits.bz2 "
    "--scene observatory_allsky; skybench study realism out/meteors --scene meteor --mask mask.bmp"
)
def realism(
    photographs: Annotated[
        list[Path],
        typer.Argument(
            metavar="PHOTOGRAPHS…",
            help="Raw FITS files of one fixed camera, with place and time; or a folder that `skybench import` wrote.",
        ),
    ],
    scene: Annotated[
        Path,
        typer.Option(
            "--scene", help="Scenario of the camera, as for `skybench twin`.", autocompletion=completion.scenarios
        ),
    ],
    calibrate_on: Annotated[
        Path | None,
        typer.Option("--calibrate-on", metavar="FITS", help="Another FITS file, that the camera is calibrated on."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option("--mask", help="For a folder: picture (PNG, BMP) whose black pixels are not sky."),
    ] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option(
            "--solver", help="Repeat for several; default: all that can run here.", autocompletion=completion.solvers
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for tables and the page.")] = REALISM_OUT,
    work: Annotated[
        Path, typer.Option("--work", help="Folder for twins and frames; what is there is used again.")
    ] = Path("out/realism"),
    as_json: AsJson = False,
) -> None:
    """Run solvers on photographs and on their rendered twins, and report whether the twins predict the photographs."""
    from benchmark.studies.realism.study import NUMBERS, PAGE, run_study
    from benchmark.twin.scene import read_scene
    from generator.scenario.shipped import find_scenario

    files = [path.name for path in photographs]
    command = shlex.join(
        ["skybench", "study", "realism", *files]
        + ([] if calibrate_on is None else ["--calibrate-on", calibrate_on.name])
        + ["--scene", str(scene)]
        + ([] if mask is None else ["--mask", mask.name])
        + [word for name in solver or () for word in ("--solver", name)]
    )
    with _one_line_for_bad_input(), _bars() as progress:
        names = _solvers(solver)
        given = read_scene(find_scenario(scene))
        study = run_study(given, photographs, calibrate_on, names, work, out, command, progress, mask)
    found = study.agreement
    lines = (
        f"tau of success {found.tau_success.value:.2f} ({found.tau_success.low:.2f} to {found.tau_success.high:.2f})",
        f"same outcome {found.same_outcome.value:.0%}, kappa {found.kappa.value:.2f}",
        f"error over the twin's {found.error_ratio.value:.2f} "
        f"({found.error_ratio.low:.2f} to {found.error_ratio.high:.2f})",
    )
    _print_study(lines, out / NUMBERS, out / PAGE, as_json)


@app.command(epilog="Example: skybench study independence --frames 12 --solver skybench --solver tetra3rs")
def independence(
    frames: Annotated[
        int, typer.Option("--frames", min=INDEPENDENCE_FEWEST, help="Frames of each set.")
    ] = INDEPENDENCE_FRAMES,
    solver: Annotated[
        list[str] | None,
        typer.Option(
            "--solver", help="Repeat for several; default: all that can run here.", autocompletion=completion.solvers
        ),
    ] = None,
    scenario: Annotated[
        Path,
        typer.Option("--scenario", help="Sites, instants, attitudes and camera.", autocompletion=completion.scenarios),
    ] = INDEPENDENCE_SCENARIO,
    out: Annotated[Path, typer.Option("--out", help="Folder for numbers and the page.")] = INDEPENDENCE_OUT,
    work: Annotated[
        Path, typer.Option("--work", help="Folder for frames and results; what is there is used again.")
    ] = Path("out/independence"),
    as_json: AsJson = False,
) -> None:
    """Change what generator and celnav share, one thing at a time, and compare every solver before and after."""
    from benchmark.studies.independence.study import NUMBERS, PAGE, run_study, summary_lines
    from generator.scenario.shipped import find_scenario

    words = ["skybench", "study", "independence"]
    if scenario != INDEPENDENCE_SCENARIO:
        words += ["--scenario", str(scenario)]
    if frames != INDEPENDENCE_FRAMES:
        words += ["--frames", str(frames)]
    command = shlex.join(words + [word for name in solver or () for word in ("--solver", name)])
    with _one_line_for_bad_input(), _bars() as progress:
        study = run_study(find_scenario(scenario), frames, _solvers(solver), work, out, command, progress)
    _print_study(summary_lines(study), out / NUMBERS, out / PAGE, as_json)


def _solvers(named: list[str] | None) -> list[str]:
    """The solvers named, or all that can run here; named ones that cannot are refused before any frame is rendered."""
    from benchmark.cli.running import obstacles
    from benchmark.run.contestants import contestant_of
    from benchmark.run.engine import check_contestants
    from benchmark.solvers.registry import solvers_by_themselves

    if named:
        check_contestants([contestant_of(name) for name in named], jobs=1)
        return list(named)
    left_out = obstacles(solvers_by_themselves())
    return [name for name in solvers_by_themselves() if name not in left_out]


def _print_study(lines: Iterable[str], numbers: Path, page: Path, as_json: bool) -> None:
    """Print the answers of a study, or all numbers that it has written, and the path of its page."""
    if as_json:
        print_json(json.loads(numbers.read_text(encoding="utf-8")) | {"page": page})
        return
    for line in lines:
        typer.echo(line)
    typer.echo(str(page))


@contextmanager
def _one_line_for_bad_input() -> Iterator[None]:
    """End the command with one line where the scenario or an option cannot be used."""
    from generator.errors import GeneratorError

    try:
        yield
    except (BenchmarkError, GeneratorError) as error:
        typer.echo(f"skybench: {error}", err=True)
        raise typer.Exit(EXIT_BAD_INPUT) from None


@contextmanager
def _bars() -> Iterator[StudyProgress]:
    """Show progress bars, one per stage, on the terminal's error stream."""
    from benchmark.studies.common.progress import StudyProgress

    with progress_bars("") as bar:
        tasks: list[TaskID] = []

        def begin(name: str, total: int) -> None:
            tasks.append(bar.add_task(name, total=total or None))

        yield StudyProgress(begin, lambda: bar.advance(tasks[-1]))


def _command(frames: int | None, dataset: Path | None, sites: int) -> str:
    parts = ["skybench study thesis"]
    if frames is not None:
        parts.append(f"--frames {frames}")
    if dataset is not None:
        parts.append(f"--dataset {shlex.quote(dataset.name)}")
    if sites != DEFAULT_SITES:
        parts.append(f"--sites {sites}")
    return " ".join(parts)
