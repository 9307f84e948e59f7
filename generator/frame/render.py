"""Render frames of a scenario into a folder (docs/dataset_format.md)."""

from __future__ import annotations

import errno
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pyarrow as pa
from numpy.typing import NDArray
from PIL import Image

from generator.errors import GeneratorError
from generator.files import atomic_path, write_bytes
from generator.frame.exposure.expected import render_expected
from generator.frame.exposure.readouts import readouts
from generator.frame.folder import FrameFolder
from generator.frame.object_table import object_table
from generator.frame.plan import FramePlan, plan_frame
from generator.frame.png import png16
from generator.frame.record import frame_record, record_bytes, star_table
from generator.frame.scene import ExpectedFrame
from generator.frame.video.take import take_video
from generator.scenario.file import Scenario
from generator.scenario.model import pointing_of
from generator.scenario.processing.develop_spec import PhotoSpec
from generator.seeds import random_stream
from generator.sensor.detector import expose
from generator.sensor.develop import develop
from generator.sensor.hud import hud_mask
from generator.sensor.maker_note import accelerometer
from generator.sensor.photo import PHOTO_SUFFIXES, Taken, check_photo, photo_bytes
from generator.sensor.sunburn import burnt_pixels

PNG_COMPRESSION = 2
LARGEST_EXR_PX = 20_000_000
"""Above this size an EXR file takes 80 MB and more."""


@dataclass(frozen=True)
class RenderedFrame:
    """A rendered frame with its complete truth.

    Attributes
    ----------
    plan : FramePlan
    expected : ExpectedFrame
    dn : (height, width) uint16 array
        Raw image.
    stars : pyarrow.Table
        Truth (schema: STAR_SCHEMA).
    objects : pyarrow.Table
        Truth of flying objects, the Moon and cosmic rays (schema: OBJECT_SCHEMA).
    hud : (height, width) bool array or None
        Pixels that the head-up display covers.
    developed : (height, width[, 3]) uint8 array or None
        8-bit picture.
    attached : dict of bytes
        Further files by their suffix (``photo.jpg`` or ``photo.heic``, ``stack.fits``, ``video.mp4``).
    """

    plan: FramePlan
    expected: ExpectedFrame
    dn: NDArray[np.uint16]
    stars: pa.Table
    objects: pa.Table
    hud: NDArray[np.bool_] | None = None
    developed: NDArray[np.uint8] | None = None
    attached: dict[str, bytes] = field(default_factory=dict)

    @property
    def mask(self) -> NDArray[np.uint8] | None:
        """Cover of the sky as a picture: 255 for pixels without sky, 0 for pixels of sky alone; None without a foreground."""
        cover = self.expected.cover
        return None if cover is None else np.rint(255 * np.clip(cover, 0, 1)).astype(np.uint8)


def render_frame(scenario: Scenario, index: int, layers: bool = False, channels: bool = True) -> RenderedFrame:
    """Render frame `index` of a scenario, with `layers` also each component separately; `channels`: see `render_expected`.

    The result depends only on the scenario and the index.
    """
    plan = plan_frame(scenario, index)
    expected = render_expected(plan, layers, channels)
    stars, objects = star_table(plan, expected), object_table(plan, expected)
    if plan.spec.sensor.video is not None:
        taken = take_video(plan, plan.spec.sensor.video)
        return RenderedFrame(plan, expected, taken.image, stars, objects, attached=taken.files)
    sensor = plan.spec.sensor
    (exposure,) = readouts(plan)
    burnt = burnt_pixels(plan.lens, sensor, exposure.unit)
    dn = expose(expected.electrons, exposure.exposure_s, sensor, exposure.frame, exposure.unit, exposure.start_s, burnt)
    developed = None if sensor.develop is None else develop(dn, sensor)
    hud = None
    if sensor.hud:
        hud = hud_mask(plan.spec.camera.width, plan.spec.camera.height, hud_lines(plan))
        dn[hud] = 2**sensor.bits - 1
        if developed is not None:
            developed[hud] = 255
    photo = None if sensor.develop is None else sensor.develop.photo
    attached = {}
    if photo is not None and developed is not None:
        attached[PHOTO_SUFFIXES[photo.format]] = photo_bytes(developed, _taken(plan, photo), photo)
    return RenderedFrame(plan, expected, dn, stars, objects, hud, developed, attached)


def _taken(plan: FramePlan, photo: PhotoSpec) -> Taken:
    """Return how the photograph of a frame was taken."""
    seed, R_mid = plan.scenario.seed, plan.motion.R_mid
    acceleration = None
    if photo.gravity is not None:
        streams = random_stream(seed, "unit.accelerometer", 0), random_stream(seed, "accelerometer", plan.index)
        acceleration = accelerometer(R_mid, photo.gravity, *streams)
    return Taken(plan.spec, plan.utc_start.isoformat(), pointing_of(R_mid), acceleration)


def hud_lines(plan: FramePlan) -> tuple[str, ...]:
    """Text of the head-up display: quantities known to a flight controller, without the position."""
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


def further_files(frame: RenderedFrame) -> dict[str, bytes]:
    """Return the files of a frame other than its image, record and expected electrons, by their suffix."""
    pictures = {
        "developed.png": frame.developed,
        "hud.png": None if frame.hud is None else hud_picture(frame.hud),
        "mask.png": frame.mask,
    }
    return {suffix: png_bytes(picture) for suffix, picture in pictures.items() if picture is not None} | frame.attached


def hud_picture(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The head-up display's mask as a picture: 255 where it covers the frame, 0 elsewhere."""
    return np.where(mask, 255, 0).astype(np.uint8)


def write_exr(path: Path, frame: RenderedFrame) -> list[str]:
    """Write expected electrons as OpenEXR files with the frame's identity in their headers; returns the file names."""
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
    _write_channels(path, header, channels)
    names_written = [path.name]
    for name, electrons in frame.expected.layers.items():
        layer = path.with_name(f"{path.stem}.{name}.exr")
        _write_channels(layer, header | {"skybench:layer": name}, {"Y": electrons})
        names_written.append(layer.name)
    return names_written


def _write_channels(path: Path, header: dict[str, Any], channels: dict[str, NDArray[np.float32]]) -> None:
    """Write an OpenEXR file atomically; a failure to write is raised as OSError, as from any other writer."""
    with atomic_path(path) as temporary, OpenEXR.File(header, channels) as file:
        try:
            file.write(str(temporary))
        except RuntimeError as error:
            raise OSError(errno.EIO, str(error).rpartition('". ')[2].rstrip(".") or str(error), str(path)) from error


def write_frame(folder: Path, frame: RenderedFrame, exr: bool = True) -> list[str]:
    """Write a frame's image, expected electrons and record, the record last; returns the file names."""
    stem = frame.plan.frame_id
    contents = {f"{stem}.png": png_bytes(frame.dn)}
    contents |= {f"{stem}-{suffix}": content for suffix, content in further_files(frame).items()}
    contents[f"{stem}.json"] = record_bytes(frame_record(frame.plan, frame.expected, frame.stars))
    expected = write_exr(folder / f"{stem}.exr", frame) if exr else []
    for name, content in contents.items():
        write_bytes(folder / name, content)
    return [*expected, *contents]


def render_dataset(
    scenario: Scenario,
    folder: Path,
    progress: Callable[[int], None] = lambda index: None,
    *,
    layers: bool = False,
    exr: bool | None = None,
    overwrite: bool = False,
) -> tuple[str, ...]:
    """Render the frames of a scenario that a folder lacks, or that are damaged there.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        Created if missing. Frames of the same scenario in it are kept, so an interrupted run is continued.
    progress : callable
        Called with the index of each finished frame.
    layers : bool
        Write the expected electrons of each component of the sky, and of the stars, in addition to the sum.
    exr : bool, optional
        Write the expected electrons; by default for images of up to LARGEST_EXR_PX pixels.
    overwrite : bool
        Replace existing frames in the folder.

    Returns
    -------
    tuple of str
        Files of an earlier run that were missing or had changed, and were written again.

    Raises
    ------
    GeneratorError
        The folder cannot be used or written; the message names the remedy.
    """
    with_exr = layers or (writes_exr(scenario) if exr is None else exr)
    check_photo(scenario.frame(0).sensor)
    place = FrameFolder(folder, scenario)
    place.open(overwrite)
    try:
        missing = place.missing(with_exr, layers)
        with_exr, layers = place.writes
        for index in sorted(set(range(scenario.frame_count)) - set(missing)):
            progress(index)
        for index in missing:
            frame = render_frame(scenario, index, layers, channels=with_exr)
            place.add(index, frame.stars, frame.objects, write_frame(folder, frame, with_exr))
            progress(index)
        place.finish()
    except OSError as error:
        raise GeneratorError(
            f"{folder}: writing failed ({error.strerror or error}); free some space and run the same command again: "
            "finished frames are kept"
        ) from error
    return tuple(place.mended)


def writes_exr(scenario: Scenario) -> bool:
    """Whether a scenario's expected electrons are written by default: not for very large images."""
    camera = scenario.frame(0).camera
    return camera.width * camera.height <= LARGEST_EXR_PX
