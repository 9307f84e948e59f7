"""`skybench verify` for a folder that `skybench render` wrote: checks files against the manifest and against each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from generator.errors import GeneratorError
from generator.frame.folder import IMU_FILE, SCHEMAS, STARS_FILE, UNFINISHED, frame_id
from generator.frame.manifest import FRAMES_MANIFEST, FramesManifest, frame_index, read_frames_manifest
from generator.imu.table import IMU_SCHEMA
from generator.reading.png_header import PNG_HEADER_BYTES, check_png
from generator.reading.record import LARGEST_RECORD_BYTES, image_shape, read_record
from generator.reading.stars import missing_rows, read_stars
from generator.reading.table import read_table
from generator.stored_files import problems_of_files, strange_files


def is_frames_folder(folder: Path) -> bool:
    """Whether a folder looks like one that `skybench render` wrote, finished or not."""
    return (
        any((folder / name).exists() for name in (FRAMES_MANIFEST, STARS_FILE, UNFINISHED))
        or next(folder.glob("frame-*.json"), None) is not None
    )


def problems(folder: Path, progress: Callable[[str], None] = lambda path: None) -> list[str]:
    """Problems of a folder of frames, one line each with the file's name; an empty list for an intact folder.

    Parameters
    ----------
    folder : Path
    progress : callable
        Called with each file that has been read.
    """
    try:
        manifest = read_frames_manifest(folder)
    except GeneratorError as error:
        return [str(error)]
    listed = {file.path for file in manifest.files}
    found = [f"{place}: missing from the manifest" for place in _wanted(manifest) if place not in listed]
    found += problems_of_files(folder, manifest.files, progress)
    found += [f"{place}: not in the manifest" for place in strange_files(folder, listed | {FRAMES_MANIFEST})]
    return found or list(_content_problems(folder, manifest))


def _wanted(manifest: FramesManifest) -> Iterator[str]:
    """Yield the files without which a folder is incomplete; the number of frames is limited by the number of listed files."""
    yield STARS_FILE
    for index in range(min(manifest.frames, len(manifest.files) + 1)):
        yield f"{frame_id(index)}.png"
        yield f"{frame_id(index)}.json"


def _content_problems(folder: Path, manifest: FramesManifest) -> Iterator[str]:
    """Yield contradictions between records, images and tables whose bytes are as listed."""
    stars_of: dict[int, int] = {}
    refused = False
    for file in manifest.files:
        index = frame_index(file.path)
        if index is not None and index >= manifest.frames:
            yield f"{file.path}: the manifest says that there are {manifest.frames} frames"
        elif file.path.endswith(".json"):
            try:
                record = _checked_record(folder, file.path, file.bytes, manifest)
                stars_of[record["index"]] = record["stars"]["n_in_field"]
            except GeneratorError as error:
                refused = True
                yield str(error)
    schemas = SCHEMAS | {IMU_FILE: IMU_SCHEMA}
    for name in sorted(schemas.keys() & {file.path for file in manifest.files}):
        try:
            read = read_stars if name == STARS_FILE else read_table
            table = read(folder / name, schemas[name], needed=schemas[name].names)
        except GeneratorError as error:
            yield str(error)
            continue
        if name == STARS_FILE and not refused:
            yield from missing_rows(STARS_FILE, stars_of, Counter(table["index"].to_pylist()))


def _checked_record(folder: Path, place: str, size: int, manifest: FramesManifest) -> dict[str, Any]:
    """Check a record against the manifest, and the images next to it against the record. Raises GeneratorError."""
    path = folder / place
    if size > LARGEST_RECORD_BYTES:
        raise GeneratorError(f"{path}: {size} bytes, larger than any frame record")
    record = read_record(path.read_bytes(), str(path), path.stem)
    if record["scenario"]["sha256"] != manifest.scenario_sha256:
        raise GeneratorError(f"{place}: belongs to another scenario than the manifest")
    for image in (f"{path.stem}{kind}.png" for kind in ("", "-developed", "-hud", "-mask")):
        if (folder / image).is_file():
            with (folder / image).open("rb") as stream:
                header = stream.read(PNG_HEADER_BYTES)
            try:
                check_png(header, image_shape(record))
            except GeneratorError as error:
                raise GeneratorError(f"{image}: is {error}") from error
    return record
