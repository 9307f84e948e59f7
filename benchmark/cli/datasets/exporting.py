"""`skybench export`: a dataset in another form."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import progress_bars
from benchmark.errors import BenchmarkError
from generator.errors import GeneratorError

FORMS = ("files", "coco", "yolo", "fits", "huggingface")
"""Forms of export, listed here so that shell completion need not load any of them."""


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Example: skybench export out/set --to coco --out out/coco")(export)


def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Dataset folder.")],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            help="files, coco, yolo, fits or huggingface.",
            autocompletion=lambda: list(FORMS),
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write; empty or new.")],
    least_snr: Annotated[
        float | None,
        typer.Option(
            "--least-snr", min=0, help="Annotate sources of this SNR or more; only of coco and yolo.  [default: 5]"
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a dataset in another form, for detectors or for astronomers.

    A copy without its truth is made by `skybench bench pack-test`.
    """
    from generator.dataset.reader import Dataset
    from generator.export.export import export as write
    from generator.export.form import ExportOptions

    try:
        manifest = Dataset.open(folder).manifest
        with progress_bars() as progress:
            task = progress.add_task("writing", total=manifest.stop - manifest.first)
            write(folder, to, out, ExportOptions(least_snr), lambda frame_id: progress.advance(task))
        if to == "huggingface":
            from benchmark.tasks.hub import task_of, write_eval

            found = task_of(manifest)
            if found is not None:
                write_eval(out, found, manifest.split)
    except (BenchmarkError, GeneratorError) as error:
        fail(error)
    if as_json:
        print_json({"form": to, "out": out})
        return
    typer.echo(f"{to} in {out}")
