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

from generator.errors import GeneratorError
from generator.files import atomic_path, write_bytes
from generator.frame.object_table import object_table
from generator.frame.plan import FramePlan, plan_frame
from generator.frame.png import png16
from generator.frame.record import STAR_SCHEMA, frame_record, record_bytes, star_table
from generator.frame.scene import ExpectedFrame, render_expected
from generator.scenario.file import Scenario
from generator.seeds import random_stream
from generator.sensor.detector import expose
from generator.sensor.develop import develop
from generator.sensor.hud import hud_mask

PNG_COMPRESSION = 2
TEMPORARY = ("frame-*", ".frame-*", ".stars-*", ".objects-*")
STARS_FILE = "stars.parquet"
OBJECTS_FILE = "objects.parquet"


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
    objects : pyarrow.Table
        Truth of flying objects (schema: OBJECT_SCHEMA).
    hud : (height, width) bool array or None
        Pixels that the head-up display covers.
    developed : (height, width[, 3]) uint8 array or None
        8-bit picture.
    """

    plan: FramePlan
    expected: ExpectedFrame
    dn: NDArray[np.uint16]
    stars: pa.Table
    objects: pa.Table
    hud: NDArray[np.bool_] | None = None
    developed: NDArray[np.uint8] | None = None


def render_frame(scenario: Scenario, index: int, layers: bool = False, channels: bool = True) -> RenderedFrame:
    """Render frame `index` of a scenario, with `layers` each component by itself too; `channels`: see `render_expected`.

    The result depends on the scenario and the index alone.
    """
    plan = plan_frame(scenario, index)
    expected = render_expected(plan, layers, channels)
    dn = expose(
        expected.electrons,
        plan.spec.time.exposure_s,
        plan.spec.sensor,
        lambda name: random_stream(scenario.seed, name, index),
        lambda name: random_stream(scenario.seed, f"unit.{name}", 0),
    )
    sensor = plan.spec.sensor
    developed = None if sensor.develop is None else develop(dn, sensor)
    hud = None
    if sensor.hud:
        hud = hud_mask(plan.spec.camera.width, plan.spec.camera.height, hud_lines(plan))
        dn[hud] = 2**sensor.bits - 1
        if developed is not None:
            developed[hud] = 255
    return RenderedFrame(plan, expected, dn, star_table(plan, expected), object_table(plan, expected), hud, developed)


def hud_lines(plan: FramePlan) -> tuple[str, ...]:
    """Text of the head-up display: what a flight controller knows, but not where it is."""
    spec = plan.spec
    return (
        plan.utc_start.isoformat()[:19] + "Z",
        f"AZ {spec.attitude.azimuth_deg:.1f} ALT {spec.attitude.altitude_deg:.1f} ROLL {spec.attitude.roll_deg:.1f}",
        f"EXP {spec.time.exposure_s:.3f} S",
    )


def png_bytes(pixels: NDArray[np.uint16] | NDArray[np.uint8]) -> bytes:
    """Encode DN as a 16-bit greyscale PNG, or an 8-bit picture as grey or colour."""
    if pixels.dtype == np.uint16:
        return png16(pixels.astype(np.uint16, copy=False))
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG", compress_level=PNG_COMPRESSION)
    return stream.getvalue()


def hud_picture(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The head-up display's mask as a picture: 255 where it covers the frame, 0 elsewhere."""
    return np.where(mask, 255, 0).astype(np.uint8)


def write_exr(path: Path, frame: RenderedFrame) -> None:
    """Write expected electrons as an OpenEXR file with the frame's identity in its header."""
    names = {"electrons": "Y", "red": "R", "green": "G", "blue": "B"}
    channels = {names[name]: pixels for name, pixels in frame.expected.channels.items()}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "skybench:frame_id": frame.plan.frame_id,
        "skybench:scenario_sha256": frame.plan.scenario.sha256,
        "skybench:utc_start": frame.plan.utc_start.isoformat(),
        "skybench:unit": "electrons",
    }
    with atomic_path(path) as temporary, OpenEXR.File(header, channels) as file:
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
    if frame.developed is not None:
        write_bytes(folder / f"{stem}-developed.png", png_bytes(frame.developed))
    if frame.hud is not None:
        write_bytes(folder / f"{stem}-hud.png", png_bytes(hud_picture(frame.hud)))
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
            if path.name not in (STARS_FILE, OBJECTS_FILE)
            and not path.name.startswith(("frame-", ".frame-", ".stars-", ".objects-"))
        ]
        if strangers:
            raise GeneratorError(f"{folder}: holds other files ({sorted(strangers)[0]}, …); choose an empty folder")
        for old in [folder / STARS_FILE, folder / OBJECTS_FILE, *(p for mark in TEMPORARY for p in folder.glob(mark))]:
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
    tables, objects = [], []
    try:
        for index in range(scenario.frame_count):
            frame = render_frame(scenario, index, layers)
            write_frame(folder, frame)
            tables.append(frame.stars)
            if frame.objects.num_rows:
                objects.append(frame.objects)
            progress(frame)
        if objects:
            with atomic_path(folder / OBJECTS_FILE) as temporary:
                pq.write_table(pa.concat_tables(objects), temporary, compression="zstd")
        write_stars(folder, tables)
    except OSError as error:
        raise GeneratorError(
            f"{folder}: writing failed ({error.strerror}); free some space and render again"
        ) from error
