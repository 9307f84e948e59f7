"""Photographs in a folder that `skybench import` wrote: their pixels, and a scene with the camera of each frame's record."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.errors import DatasetError, PhotographError
from benchmark.frames.dataset import Frame, load_image, open_dataset, true_observation
from benchmark.frames.record_values import RENDER_AGAIN, integer, number, optional_number, read_record, text, value
from benchmark.photographed.alignment import Alignment
from benchmark.twin.photograph import LONGEST_S, Photograph, name_of
from benchmark.twin.scene import Scene, changed_scene
from benchmark.twin.stacked_video import start_of
from generator.errors import GeneratorError
from generator.scenario.model import HIGHEST_SITE_M, LOWEST_SITE_M, pointing_of

IMPORT_AGAIN = "import the photographs again with `skybench import photos`"
SHORTEST_S = 1e-6
GEOMETRY = (
    "model", "width", "height", "hfov_deg", "f_px", "focal_length_mm", "pixel_aspect", "cx_px", "cy_px",
    "k", "p", "s", "tilt_rad",
)  # fmt: skip
"""Keys of a scene's camera that a record replaces."""
AIR = ("pressure_hpa", "temperature_c", "relative_humidity")
"""Numbers of the air with which a record's stars are refracted; the twin has the same."""


@dataclass(frozen=True, eq=False)
class ImportedFrame:
    """A photograph of a dataset.

    Attributes
    ----------
    path : Path
        Path of the frame record.
    record : dict
    frame : Frame
    """

    path: Path
    record: dict[str, Any]
    frame: Frame

    @property
    def file(self) -> str:
        """Name of the photograph's file, from which it was imported."""
        with _import_again():
            return text(self.path, self.record, "photograph.file")

    @property
    def name(self) -> str:
        """Name of the photograph."""
        return name_of(Path(self.file))


def imported_frames(folder: Path) -> list[ImportedFrame]:
    """Read the frame records of a dataset of photographs.

    Raises
    ------
    PhotographError
        The folder holds no such dataset, or it is unfinished or damaged; the message names the file and the remedy.
    """
    if next(folder.glob("frame-*.json"), None) is None:
        raise PhotographError(
            f"{folder}: no frame-*.json in it; give FITS files, or a folder that `skybench import photos` wrote"
        )
    found = []
    with _import_again():
        for frame in open_dataset(folder).frames:
            path = frame.image_path.with_suffix(".json")
            record = read_record(path)
            if not isinstance(record.get("photograph"), dict):
                raise PhotographError(
                    f"{path}: key photograph is missing, so the frame was rendered; give a folder that "
                    "`skybench import photos` wrote"
                )
            found.append(ImportedFrame(path, record, frame))
    return found


def read_imported(given: ImportedFrame) -> Photograph:
    """Read a photograph with the numbers of its file, and its place, time and attitude.

    Raises
    ------
    PhotographError
        The image cannot be read, or the record lacks a value; the message names file, key and remedy.
    """
    path, record = given.path, given.record
    with _import_again():
        scale = number(path, record, "photograph.scale", 1e-9)
        offset_dn = number(path, record, "photograph.offset_dn")
        rms_px = optional_number(path, record, "photograph.aligned_rms_px")
        aligned = Alignment(
            R_cam=true_observation(path, record).R_cam,
            stars=integer(path, record, "photograph.aligned_stars"),
            rms_px=float("nan") if rms_px is None else rms_px,
            turned_deg=optional_number(path, record, "photograph.turned_deg") or 0.0,
        )
        return Photograph(
            name=given.name,
            pixels=((load_image(given.frame) - offset_dn) / scale).astype(np.float32),
            utc_start=text(path, record, "time.utc_start"),
            exposure_s=number(path, record, "time.exposure_s", SHORTEST_S, LONGEST_S),
            latitude_deg=number(path, record, "site.latitude_deg", -90.0, 90.0),
            longitude_deg=number(path, record, "site.longitude_deg", -180.0, 360.0),
            height_m=number(path, record, "site.height_m", LOWEST_SITE_M, HIGHEST_SITE_M),
            mean_of_video=start_of(given.file) is not None,
            alignment=aligned,
            told=record.get("told"),
        )


def scene_of(scene: Scene, given: ImportedFrame, photograph: Photograph) -> Scene:
    """The scene with the lens, the place, the time, the attitude and the air of a photograph's record.

    Aperture, pixels, sensor, ground and cities stay the scene's. Its image circle is kept as an angle: it is scaled with the
    focal length.

    Raises
    ------
    PhotographError
        The record's camera cannot be rendered, or its colours are not those of the scene's sensor.
    """
    path, record = given.path, given.record
    with _import_again():
        seen = true_observation(path, record)
        air = {name: optional_number(path, record, f"atmosphere.{name}") for name in AIR}
        mosaic = value(path, record, "sensor.bayer_pattern")
    colour = scene.spec.sensor.colour
    pattern = None if colour is None else colour.pattern
    if mosaic != pattern:
        raise PhotographError(
            f"{path}: sensor.bayer_pattern is {mosaic or 'null'}, that of {scene.path} {pattern or 'null'}; give a --scene "
            "with the photograph's colours"
        )
    camera, pointing = seen.camera, pointing_of(seen.R_cam)
    lens = {name: part for name, part in scene.tree["camera"].items() if name not in GEOMETRY} | {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "f_px": camera.f_px,
        "pixel_aspect": camera.fy_px / camera.f_px,
        "cx_px": camera.cx_px,
        "cy_px": camera.cy_px,
        **{name: list(getattr(camera, name)) for name in ("k", "p", "s", "tilt_rad")},
    }
    circle_px = scene.spec.camera.image_circle_px
    if circle_px is not None:
        lens["image_circle_px"] = circle_px * camera.f_px / scene.spec.camera.f_px
    own = {
        "camera": lens,
        "site": {
            "latitude_deg": photograph.latitude_deg,
            "longitude_deg": photograph.longitude_deg,
            "height_m": photograph.height_m,
        },
        "time": {"utc_start": photograph.utc_start, "exposure_s": photograph.exposure_s},
        "attitude": pointing.model_dump(),
        "atmosphere": (scene.tree.get("atmosphere") or {})
        | {name: each for name, each in air.items() if each is not None},
    }
    try:
        return changed_scene(scene, own)
    except GeneratorError as error:
        raise PhotographError(
            f"{path}: camera, site and time do not make a scene with {scene.path} ({error})"
        ) from error


@contextlib.contextmanager
def _import_again() -> Iterator[None]:
    """Turn complaints about rendered frames into those about imported ones, with the remedy."""
    try:
        yield
    except DatasetError as error:
        words = str(error).removesuffix(f"; {RENDER_AGAIN}").removesuffix(f", {RENDER_AGAIN}")
        raise PhotographError(f"{words}; {IMPORT_AGAIN}") from error
