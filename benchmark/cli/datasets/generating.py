"""`skybench generate`: a dataset in shards, by one machine or many."""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import print_warnings
from benchmark.cli.progress import progress_bars
from benchmark.cli.rendering import Scenario
from generator.errors import GeneratorError

if TYPE_CHECKING:
    from generator.dataset.run import Part, Runner, ShardRange


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Example: skybench generate thesis_mag --out out/thesis-mag")(generate)


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
    """Make a dataset in shards; after an interruption, the same command continues it."""
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
    """Shards of this job among those of the dataset."""
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
