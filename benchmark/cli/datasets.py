"""Commands on datasets: plan, generate, verify, export, show."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables, print_warnings
from benchmark.cli.progress import progress_bars, working
from benchmark.cli.rendering import Scenario
from generator.errors import GeneratorError

if TYPE_CHECKING:
    from generator.dataset.forecast import Forecast
    from generator.dataset.run import Part, Runner, ShardRange
    from generator.scenario.file import Scenario as LoadedScenario

FORMS = ("files", "coco", "yolo", "fits", "huggingface", "withheld")
"""Forms of export, known to the completion of the shell without loading any of them."""


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(epilog="Example: skybench plan thesis_mag")(plan)
    app.command(epilog="Example: skybench generate thesis_mag --out out/thesis-mag")(generate)
    app.command(epilog="Exit status: 0 whole, 1 damaged.")(verify)
    app.command(epilog="Example: skybench export out/set --to coco --out out/coco")(export)
    app.command(epilog="Example: skybench show out/set, then open out/set-show/index.html")(show)


def plan(
    scenario: Scenario,
    measure: Annotated[
        bool, typer.Option("--measure", help="Render four frames, not the first alone, to know time and size.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Print what a scenario would make: frames, values, light, stars, time and size; and what looks like a slip."""
    from rich.table import Column, Table

    from benchmark.report.formatting import duration, file_size
    from generator.dataset.forecast import forecast
    from generator.dataset.layout import natural_shard_size
    from generator.scenario.file import load_scenario
    from generator.scenario.shipped import find_scenario

    try:
        loaded = load_scenario(find_scenario(scenario))
        with working("planning"):
            expected = forecast(loaded, measure)
    except GeneratorError as error:
        fail(error)
    sweeps = {".".join(sweep.path): sweep.values for axis in loaded.axes for sweep in axis}
    draws = {".".join(draw.path): _as_written(loaded.template, draw.path) for draw in loaded.draws}
    files = {file.path: file.sha256 for file in loaded.files}
    if as_json:
        identity = {"name": loaded.name, "sha256": loaded.sha256, "seed": loaded.seed}
        identity |= {"sequences": loaded.sequence_count, "frames_per_sequence": loaded.steps}
        varied = {"sweeps": {key: list(values) for key, values in sweeps.items()}, "draws": draws, "files": files}
        print_json(identity | asdict(expected) | varied)
        return
    table = Table("", Column(loaded.name, overflow="fold"), show_header=True)
    table.add_row("frames", _frames(loaded))
    if loaded.sequence_count:
        table.add_row("sequence", _sequence(loaded))
    for name, values in sweeps.items():
        table.add_row(f"sweep {name}", _listing(values))
    for name, distribution in draws.items():
        table.add_row(f"draw {name}", distribution)
    for name in files:
        table.add_row("file", name)
    for row in _first_frame(expected):
        table.add_row(*row)
    known = "from four frames" if expected.measured else "from the first frame; --measure renders four"
    table.add_row("time", f"{duration(expected.seconds)} with `generate` on {expected.cores} cores ({known})")
    table.add_row(
        "size",
        f"{file_size(expected.bytes)} as 16-bit PNG with truth; {file_size(expected.exr_bytes)} more "
        "with the expected electrons (EXR)",
    )
    size = natural_shard_size(loaded.frame_count)
    table.add_row("shards", f"{math.ceil(loaded.frame_count / size)} of up to {size} frames")
    table.add_row("scenario hash", loaded.sha256)
    print_tables(table)
    print_warnings(expected.warnings)


def _frames(scenario: LoadedScenario) -> str:
    steps = "" if scenario.steps is None else f" sequences x {scenario.steps} frames"
    return f"{scenario.frame_count} ({scenario.combination_count} combinations x {scenario.repeats}{steps})"


def _sequence(scenario: LoadedScenario) -> str:
    """Times and inertial unit of the first sequence."""
    spec = scenario.sequence(0)
    end = scenario.frame(spec.time.count - 1).time.utc_start
    inertial = "" if spec.imu is None else f"; inertial unit at {spec.imu.rate_hz:g} Hz"
    return f"every {spec.time.every_s:g} s from {spec.time.utc_start} to {end}{inertial}"


def _first_frame(expected: Forecast) -> list[tuple[str, str]]:
    """Rows of the table about the first frame."""
    from generator.frame.record import VISIBLE_SNR

    first = expected.first
    signal_e = first.sky_e + first.dark_e
    return [
        ("image", f"{expected.width} x {expected.height}, {expected.bits} bits"),
        ("field of view", f"{first.hfov_deg:.4g} x {first.vfov_deg:.4g} deg"),
        (
            "pointing",
            f"azimuth {first.azimuth_deg:.2f}, altitude {first.altitude_deg:.2f}, roll {first.roll_deg:.2f} deg",
        ),
        ("f-number", "unknown without pixel_pitch_um" if first.f_number is None else f"f/{first.f_number:.3g}"),
        (
            "sky and dark",
            f"{first.sky_e:.3g} + {first.dark_e:.3g} e per pixel: {signal_e / first.full_well_e:.2%} of the full well "
            f"({first.full_well_e:g} e), {signal_e / first.range_e:.2%} of the converter's range ({first.range_e:.4g} e)",
        ),
        (
            "stars",
            f"{first.visible_stars} with SNR >= {VISIBLE_SNR:g}, {first.saturated_stars} saturated; "
            f"{expected.catalogue_stars} in the catalogue above the horizon",
        ),
        ("saturated pixels", f"{first.saturated_share:.2%}"),
        ("Sun, Moon", f"altitudes {first.sun_altitude_deg:.1f}, {first.moon_altitude_deg:.1f} deg"),
    ]


def _listing(values: tuple[object, ...]) -> str:
    shown = ", ".join(str(value) for value in values[:12])
    return shown + (f", … ({len(values)})" if len(values) > 12 else "")


def _as_written(tree: Any, path: tuple[str, ...]) -> str:
    """A scenario's value as its file has it, on one line."""
    import yaml

    for key in path:
        tree = tree[int(key)] if isinstance(tree, list) else tree[key]
    return yaml.safe_dump(tree, default_flow_style=True, width=1000).strip()


def generate(
    scenario: Scenario,
    out: Annotated[str, typer.Option("--out", help="Folder (or URL such as s3://…); a begun dataset is continued.")],
    frames: Annotated[str, typer.Option("--frames", metavar="FIRST:STOP", help="Frames to make, STOP excluded.")] = "",
    split: Annotated[str, typer.Option("--split", help="Name of the split.")] = "train",
    shard_size: Annotated[
        int | None,
        typer.Option("--shard-size", min=1, help="Frames per shard; default: 100, fewer for fewer than 3200 frames."),
    ] = None,
    exr: Annotated[bool, typer.Option("--exr", help="Store the expected electrons too.")] = False,
    codec: Annotated[
        str,
        typer.Option("--codec", help="png, or jxl (lossless JPEG XL).", autocompletion=lambda: ["png", "jxl"]),
    ] = "png",
    workers: Annotated[int, typer.Option("--workers", min=0, help="Processes; default: one per core.")] = os.cpu_count()
    or 1,
    part: Annotated[str, typer.Option("--part", metavar="I/N", help="Make the I-th of N parts (job arrays).")] = "",
    shards: Annotated[
        str, typer.Option("--shards", metavar="FIRST:STOP", help="Make these shards alone, STOP excluded (job arrays).")
    ] = "",
    backend: Annotated[
        str, typer.Option("--backend", help="local, or ray.", autocompletion=lambda: ["local", "ray"])
    ] = "local",
    ray_address: Annotated[
        str, typer.Option("--ray-address", help="Of a running cluster; else one is started here.")
    ] = "",
    as_json: Annotated[
        bool, typer.Option("--json", help="Report progress as JSON lines on standard output, one document to a line.")
    ] = False,
) -> None:
    """Make a dataset in shards; killed and started again, it goes on where it was."""
    from rich.progress import TaskProgressColumn, TextColumn

    from generator.dataset.generate import generate as make
    from generator.dataset.layout import DatasetSpec, natural_shard_size
    from generator.dataset.shard import ShardReport
    from generator.scenario.contradictions import contradictions_of
    from generator.scenario.file import load_scenario
    from generator.scenario.shipped import find_scenario

    started = time.monotonic()
    own_lines = sys.stdout  # a backend may redirect the stream while it runs

    def tell(event: dict[str, object]) -> None:
        if as_json:
            typer.echo(json.dumps(event), file=own_lines)

    try:
        path = find_scenario(scenario)
        loaded = load_scenario(path)
        print_warnings(contradictions_of(loaded))
        chosen = _range("--frames", frames) if frames else (0, loaded.frame_count)
        share = _share(part, shards)
        spec = DatasetSpec(split, shard_size or natural_shard_size(loaded.frame_count), exr, codec)
        done = failed = 0
        rates = TaskProgressColumn(show_speed=True), TextColumn("{task.fields[rate]}")
        with progress_bars("frames", *rates, hidden=as_json) as progress:
            task = progress.add_task("rendering", total=chosen[1] - chosen[0], rate="")

            def frame_done(frame: int) -> None:
                nonlocal done
                done += 1
                rate = done / (time.monotonic() - started)
                progress.update(task, advance=1, rate=f"{rate:.1f} frames/s, {failed} failed")
                tell({"event": "frame", "index": frame, "done": done, "frames_per_s": round(rate, 3)})

            def shard_done(report: ShardReport) -> None:
                nonlocal failed
                failed += len(report.failures)
                if report.skipped:
                    progress.advance(task, report.shard.stop - report.shard.first)
                state = "kept" if report.skipped else "done" if report.complete else "failed"
                failures = [asdict(failure) for failure in report.failures]
                tell({"event": "shard", "shard": report.shard.stem, "state": state, "failures": failures})

            report = make(loaded, path.read_text(encoding="utf-8"), out, spec, chosen, share, workers,
                          _backend(backend, ray_address), frame_done, shard_done)  # fmt: skip
    except GeneratorError as error:
        fail(error)
    for failure in report.failures:
        typer.echo(f"skybench: frame {failure.index} failed: {failure.error}", err=True)
    finished = not report.missing
    if not as_json:
        for place in report.mended:
            typer.echo(f"{place}: was damaged or missing, and is made again")
    if as_json:
        tell({"event": "end", "finished": finished, "missing_shards": len(report.missing), "mended": report.mended})
    elif finished:
        typer.echo(f"{chosen[1] - chosen[0]} frames in {out}; check them with: skybench verify {out}")
    else:
        typer.echo(f"{len(report.missing)} shards are still missing in {out}")
    raise typer.Exit(1 if report.failures else 0)


def _backend(name: str, ray_address: str) -> Runner:
    from generator.dataset.ray_backend import ray_runner
    from generator.dataset.run import run_shards

    if name == "local":
        return run_shards
    if name == "ray":
        return ray_runner(ray_address or None)
    raise GeneratorError(f"--backend {name}: one of local, ray")


def _range(option: str, text: str) -> tuple[int, int]:
    first, colon, stop = text.partition(":")
    if not colon or not _is_number(first) or not _is_number(stop):
        raise GeneratorError(f"{option} {text}: expected FIRST:STOP, for example 120:121")
    return int(first), int(stop)


def _share(part: str, shards: str) -> Part | ShardRange:
    """Shards of this job, of those that the dataset has."""
    from generator.dataset.run import Part, ShardRange

    if part and shards:
        raise GeneratorError(f"--part {part} with --shards {shards}: give one of the two")
    if shards:
        return ShardRange(*_range("--shards", shards))
    if not part:
        return Part()
    index, slash, count = part.partition("/")
    if not slash or not _is_number(index) or not _is_number(count):
        raise GeneratorError(f"--part {part}: expected I/N, for example 0/4")
    return Part(int(index), int(count))


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 10


def verify(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Dataset, or folder of rendered frames.")],
    as_json: AsJson = False,
) -> None:
    """Check every file of a dataset, or of a folder of rendered frames, against its manifest."""
    from generator.dataset.layout import MANIFEST
    from generator.dataset.verify import NOT_COVERED, problems
    from generator.frame import verify as frames

    of_frames = not (folder / MANIFEST).is_file() and frames.is_frames_folder(folder)
    with working("reading") as status:
        found = (frames.problems if of_frames else problems)(folder, lambda path: status.update(f"reading {path}"))
    if as_json:
        print_json({"folder": folder, "whole": not found, "problems": found})
        raise typer.Exit(1 if found else 0)
    for problem in found:
        typer.echo(problem)
    if not found:
        typer.echo(f"{folder}: whole" + ("" if of_frames else f" (not covered: {NOT_COVERED}/)"))
    raise typer.Exit(1 if found else 0)


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Dataset folder.")],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            help="files, coco, yolo, fits, huggingface, or withheld (without its truth).",
            autocompletion=lambda: list(FORMS),
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write; empty or new.")],
    least_snr: Annotated[
        float, typer.Option("--least-snr", min=0, help="Annotate sources of this SNR or more (coco, yolo).")
    ] = 5.0,
    as_json: AsJson = False,
) -> None:
    """Write a dataset in another form: for detectors, for astronomers, or without its truth."""
    from generator.dataset.manifest import read_manifest
    from generator.export.export import export as write
    from generator.export.form import ExportOptions

    try:
        manifest = read_manifest(folder)
        with progress_bars() as progress:
            task = progress.add_task("writing", total=manifest.stop - manifest.first)
            write(folder, to, out, ExportOptions(least_snr), lambda frame_id: progress.advance(task))
        if to == "huggingface":
            from benchmark.tasks.hub import task_of, write_eval

            found = task_of(manifest)
            if found is not None:
                write_eval(out, found, manifest.split)
    except GeneratorError as error:
        fail(error)
    if as_json:
        print_json({"form": to, "out": out})
        return
    typer.echo(f"{to} in {out}")


def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Dataset, or folder of rendered frames.")],
    out: Annotated[Path | None, typer.Option("--out", help="Folder to write; default: DIR-show beside DIR.")] = None,
    frames: Annotated[int, typer.Option("--frames", min=1, max=1000, help="Most frames on the page.")] = 48,
    page: Annotated[
        int | None,
        typer.Option(
            "--page", min=1, help="Show the frames in order, those of this page; default: evenly spread ones."
        ),
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option("--video", metavar="FILE.mp4", help="Write a video of all frames instead of the page."),
    ] = None,
    fps: Annotated[float, typer.Option("--fps", help="Frames of the video per second.")] = 10.0,
    truth: Annotated[
        bool, typer.Option("--truth", help="Draw time, place, attitude and star names over the video.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Write a page to look at a dataset: contact sheet, frames with their truth, filters, histograms; or a video."""
    if video is not None:
        if page is not None:
            fail(GeneratorError("--page: not with --video, which has all frames"))
        _show_video(folder, video, fps, truth, as_json)
        return
    if truth:
        fail(GeneratorError("--truth: only with --video; the page shows the truth of each frame by itself"))
    from benchmark.report.show.page import write_page

    place = folder.resolve()
    try:
        with progress_bars() as progress:
            task = progress.add_task("drawing", total=frames)
            written = write_page(
                folder,
                out or place.with_name(f"{place.name}-show"),
                frames,
                lambda done, of: progress.update(task, completed=done, total=of),
                page,
            )
    except GeneratorError as error:
        fail(error)
    if as_json:
        print_json({"page": written.page, "shown": written.shown, "frames": written.frames, "size_bytes": written.size})
        return
    typer.echo(f"{written.shown} of {written.frames} frames, {written.size / 1e6:.1f} MB: open {written.page}")


def _show_video(folder: Path, video: Path, fps: float, truth: bool, as_json: bool) -> None:
    from benchmark.report.show.video import write_video

    try:
        with progress_bars() as progress:
            task = progress.add_task("encoding", total=None)
            count = write_video(
                folder, video, fps, truth, lambda done, of: progress.update(task, completed=done, total=of)
            )
    except GeneratorError as error:
        fail(error)
    size = video.stat().st_size
    if as_json:
        print_json({"video": video, "frames": count, "seconds": count / fps, "size_bytes": size})
        return
    typer.echo(f"{count} frames, {count / fps:.1f} s, {size / 1e6:.1f} MB: {video}")
