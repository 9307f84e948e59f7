"""`skybench show`: a page, or a video, for viewing a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json
from benchmark.cli.progress import progress_bars
from generator.errors import GeneratorError


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Example: skybench show out/set, then open out/set-show/index.html")(show)


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
    """Write a page for viewing a dataset: contact sheet, frames with their truth, filters, histograms; or a video."""
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
