"""Photographs and their twins as two datasets that are produced in the same way.

Each dataset has a camera calibrated from the stars of one of its own frames (of a photograph, or of that photograph's twin),
and is imported with it, so solvers receive nothing of the scene's camera.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import celnav
from benchmark.errors import PhotographError
from benchmark.importing.told import ToldCamera
from benchmark.importing.write import Import, import_photographs
from benchmark.place import Place
from benchmark.studies.realism.likeness import Likeness, likenesses
from benchmark.twin.photograph import Photograph, read_photograph
from benchmark.twin.render_twin import make_twin
from benchmark.twin.report import SNR_BINS, WIDTH_BINS, numbers_of_twin
from benchmark.twin.scene import Scene
from celnav.command.calibration_frames import read_frames
from generator.files import atomic_path, write_bytes

Floats = np.ndarray[Any, np.dtype[np.float32]]

REAL, TWINS = "real", "twins"
"""Names of the two datasets."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Two datasets of the same frames.

    Attributes
    ----------
    names : tuple of str
        Names of the photographs, in the order of the frames.
    real, twins : Path
        Folders of the datasets.
    measures : list of dict
        Measurements on each pair (`benchmark.twin.report.numbers_of_twin`), with the frame of the calibration last.
    likenesses : list of Likeness
        Similarities of the same pairs.
    real_indices : tuple of int
        Index of each photograph in its dataset; twins are numbered in the order of the names.
    n_real : int
        Number of photographs in their dataset.
    left_out : tuple of str
        Photographs of the dataset without a twin.
    """

    names: tuple[str, ...]
    real: Path
    twins: Path
    measures: list[dict[str, Any]]
    likenesses: list[Likeness]
    real_indices: tuple[int, ...]
    n_real: int
    left_out: tuple[str, ...] = ()


def make_pairs(
    scene: Scene,
    photographs: Sequence[Path],
    calibrated_on: Path,
    work: Path,
    progress: Callable[[], None] = lambda: None,
) -> Pairs:
    """Render the missing twins, calibrate both cameras and import both sets.

    Parameters
    ----------
    scene : Scene
        Scene of the fixed camera.
    photographs : sequence of Path
        FITS files on which solvers are judged.
    calibrated_on : Path
        The photograph on which the camera is calibrated; not one of the others.
    work : Path
        Folder for everything that is produced; its content is reused.
    progress : callable
        Called after each twin.

    Raises
    ------
    PhotographError
        A photograph cannot be used, or the calibration fails.
    """
    if calibrated_on.name in {path.name for path in photographs}:
        raise PhotographError(
            f"{calibrated_on}: the photograph of the calibration is judged too; leave it out of the others"
        )
    twins, measures = [], []
    for path in (*photographs, calibrated_on):
        made, numbers = _twin(scene, path, work)
        twins.append(made)
        measures.append(numbers)
        progress()
    first = read_photograph(photographs[0])
    place = Place(first.latitude_deg, first.longitude_deg, first.height_m)
    folders = {}
    for name, files in ((REAL, [*photographs, calibrated_on]), (TWINS, twins)):
        folders[name] = work / name
        told = _calibrated(files[-1], place)
        import_photographs(Import(f"realism-{name}", files[:-1], place, told), folders[name], True)
    names = tuple(read_photograph(path).name for path in photographs)
    real = [read_photograph(path).pixels for path in (*photographs, calibrated_on)]
    alike = likenesses_in_circle(scene, real, [_read_fits(path) for path in twins], scene.spec.sensor.black_level_dn)
    return Pairs(names, folders[REAL], folders[TWINS], measures, alike, tuple(range(len(names))), len(names))


def likenesses_in_circle(
    scene: Scene, real: Sequence[Floats], made: Sequence[Floats], dark_dn: float
) -> list[Likeness]:
    """Compare pictures, DN, within the image circle of the scene's camera, or the largest circle in the frame."""
    camera = scene.spec.camera
    middle = camera.projection
    circle_px = camera.image_circle_px or min(camera.width, camera.height) / 2
    return likenesses(real, made, dark_dn, (middle.cx_px, middle.cy_px), circle_px)


def _calibrated(path: Path, place: Place) -> ToldCamera:
    """Calibrate lens and mount from the stars of one frame, with a blind start."""
    try:
        found = celnav.calibrate(
            read_frames([str(path)]), place.latitude_deg, place.longitude_deg, height_m=place.height_m
        )
    except celnav.CelnavError as error:
        raise PhotographError(f"{path}: cannot be calibrated on ({error})") from error
    return ToldCamera.calibrated(found)


def _twin(scene: Scene, path: Path, work: Path) -> tuple[Path, dict[str, Any]]:
    """Twin of a photograph as a FITS file, and the measurements on the two; produced if missing."""
    photograph = read_photograph(path)
    picture, numbers = work / "pictures" / f"{photograph.name}.fits", work / "pictures" / f"{photograph.name}.json"
    if picture.is_file() and (kept := _kept_numbers(numbers)) is not None:
        return picture, kept
    twin = make_twin(scene, photograph, work / "scenarios")
    _write_fits(picture, photograph, twin.pixels)
    write_bytes(numbers, (json.dumps(numbers_of_twin(twin), indent=1) + "\n").encode())
    return picture, json.loads(numbers.read_text(encoding="utf-8"))


def _kept_numbers(path: Path) -> dict[str, Any] | None:
    """Measurements of an earlier run; None without, and for those of a version that measured less."""
    if not path.is_file():
        return None
    numbers: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return numbers if {SNR_BINS, WIDTH_BINS} <= numbers.keys() else None


def _write_fits(path: Path, photograph: Photograph, pixels: np.ndarray[Any, np.dtype[np.uint16]]) -> None:
    """Write a twin's pixels with the photograph's time."""
    from astropy.io import fits

    unit = fits.PrimaryHDU(pixels)
    unit.header["DATE-OBS"] = photograph.utc_start.rstrip("Z")
    unit.header["EXPTIME"] = photograph.exposure_s
    with atomic_path(path) as temporary:
        unit.writeto(temporary, overwrite=True)


def _read_fits(path: Path) -> Floats:
    """Pixels of a twin."""
    from astropy.io import fits

    return np.asarray(fits.getdata(path), dtype=np.float32)
