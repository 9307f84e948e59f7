"""Rendering frames of a scenario into a folder (docs/dataset_format.md)."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image

from generator.detector import expose
from generator.errors import GeneratorError
from generator.files import atomic_path, write_bytes
from generator.frame_plan import FramePlan, plan_frame
from generator.frame_record import STAR_SCHEMA, frame_record, record_bytes, star_table
from generator.scenario_file import Scenario
from generator.scene import ExpectedFrame, render_expected
from generator.seeds import random_stream

PNG_COMPRESSION = 4
STARS_FILE = "stars.parquet"


@dataclass(frozen=True)
class RenderedFrame:
    """A frame with everything that is known about it.

    Attributes
    ----------
    plan : FramePlan
    expected : ExpectedFrame
    dn : (height, width) uint16 array
        What the camera recorded.
    stars : pyarrow.Table
        Truth (schema: STAR_SCHEMA).
    """

    plan: FramePlan
    expected: ExpectedFrame
    dn: NDArray[np.uint16]
    stars: pa.Table


def render_frame(scenario: Scenario, index: int, layers: bool = False) -> RenderedFrame:
    """Render frame `index` of a scenario, with `layers` each component by itself too.

    The result depends on the scenario and the index alone.
    """
    plan = plan_frame(scenario, index)
    expected = render_expected(plan, layers)
    dn = expose(
        expected.electrons,
        plan.spec.time.exposure_s,
        plan.spec.sensor,
        lambda name: random_stream(scenario.seed, name, index),
    )
    return RenderedFrame(plan, expected, dn, star_table(plan, expected))


def png_bytes(dn: NDArray[np.uint16]) -> bytes:
    """Encode DN as a 16-bit greyscale PNG."""
    stream = io.BytesIO()
    Image.fromarray(dn).save(stream, format="PNG", compress_level=PNG_COMPRESSION)
    return stream.getvalue()


def write_exr(path: Path, frame: RenderedFrame) -> None:
    """Write expected electrons as an OpenEXR file with the frame's identity in its header."""
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "skybench:frame_id": frame.plan.frame_id,
        "skybench:scenario_sha256": frame.plan.scenario.sha256,
        "skybench:utc_start": frame.plan.utc_start.isoformat(),
        "skybench:unit": "electrons",
    }
    with atomic_path(path) as temporary, OpenEXR.File(header, {"Y": frame.expected.electrons}) as file:
        file.write(str(temporary))
    for name, electrons in frame.expected.layers.items():
        with (
            atomic_path(path.with_name(f"{path.stem}.{name}.exr")) as temporary,
            OpenEXR.File(header | {"skybench:layer": name}, {"Y": electrons}) as file,
        ):
            file.write(str(temporary))


def write_frame(folder: Path, frame: RenderedFrame) -> None:
    """Write a frame's image, expected electrons and record; the record last, as a mark that the frame is whole."""
    stem = frame.plan.frame_id
    write_bytes(folder / f"{stem}.png", png_bytes(frame.dn))
    write_exr(folder / f"{stem}.exr", frame)
    write_bytes(folder / f"{stem}.json", record_bytes(frame_record(frame.plan, frame.expected, frame.stars.num_rows)))


def write_stars(folder: Path, tables: Sequence[pa.Table]) -> None:
    """Write the truth tables of all frames as one Parquet file."""
    table = pa.concat_tables(tables) if tables else STAR_SCHEMA.empty_table()
    with atomic_path(folder / STARS_FILE) as temporary:
        pq.write_table(table, temporary, compression="zstd")


def prepare_folder(folder: Path) -> None:
    """Make the folder for a dataset; refuse one that holds something else.

    Frames of an earlier run are replaced; its table of stars is removed first, so that a folder never looks finished while
    it is being written.

    Raises
    ------
    GeneratorError
        The folder cannot be written, or holds files that are not a dataset's.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        strangers = [
            path.name
            for path in folder.iterdir()
            if path.name != STARS_FILE and not path.name.startswith(("frame-", ".frame-", ".stars-"))
        ]
        if strangers:
            raise GeneratorError(f"{folder}: holds other files ({sorted(strangers)[0]}, …); choose an empty folder")
        for old in [folder / STARS_FILE, *folder.glob("frame-*"), *folder.glob(".frame-*"), *folder.glob(".stars-*")]:
            old.unlink(missing_ok=True)
    except OSError as error:
        raise GeneratorError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error


def render_dataset(
    scenario: Scenario,
    folder: Path,
    progress: Callable[[RenderedFrame], None] = lambda frame: None,
    layers: bool = False,
) -> None:
    """Render all frames of a scenario into a folder; `progress` is called with each frame once it is written.

    With `layers`, the expected electrons of each component of the sky, and of the stars, are written beside the sum.

    Raises
    ------
    GeneratorError
        With what to do about it.
    """
    prepare_folder(folder)
    tables = []
    try:
        for index in range(scenario.frame_count):
            frame = render_frame(scenario, index, layers)
            write_frame(folder, frame)
            tables.append(frame.stars)
            progress(frame)
        write_stars(folder, tables)
    except OSError as error:
        raise GeneratorError(
            f"{folder}: writing failed ({error.strerror}); free some space and render again"
        ) from error
