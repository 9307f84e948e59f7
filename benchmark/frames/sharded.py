"""Frames of a sharded dataset, on this machine or in an object store, unpacked to where programs can read them."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import DatasetError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import FrameSet, ungraded
from benchmark.frames.task_frames import UNPACKED
from generator.dataset.archive import StoredFrame, check_holes, read_frames
from generator.dataset.images import decode, encode
from generator.dataset.layout import MANIFEST
from generator.dataset.manifest import Manifest, read_manifest
from generator.dataset.target import LocalTarget, Target, open_target
from generator.errors import GeneratorError
from generator.files import linked_within, path_within, write_bytes
from generator.reading.record import image_shape, read_record
from generator.stored_files import LARGEST_MANIFEST_BYTES, StoredFile, stored_file

DATASETS = "datasets"
"""Name of the folder of unpacked datasets within the folder of all frames."""


def dataset_folder(manifest_sha256: str, data: Path) -> Path:
    """Folder of an unpacked dataset."""
    return data / DATASETS / manifest_sha256[:12]


def open_sharded(place: str, data: Path, progress: Callable[[int], None] = lambda frames: None) -> FrameSet:
    """Fetch and unpack the missing parts of a dataset, check every file against its manifest, and read its frames.

    Parameters
    ----------
    place : str
        Argument of `skybench generate --out`: a folder, or a URL such as ``s3://bucket/name``.
    data : Path
        Folder of all frames; within it the dataset has its own folder, named after the hash of its manifest.
    progress : callable
        Called with the number of frames that have become available.

    Raises
    ------
    DatasetError
        The dataset cannot be reached, is unfinished or damaged.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="skybench-") as scratch:
            target = open_target(place)
            path = _fetched(target, MANIFEST, Path(scratch), LARGEST_MANIFEST_BYTES)
            manifest, digest = read_manifest(path.parent), hashlib.sha256(path.read_bytes()).hexdigest()
            folder = dataset_folder(digest, data)
            stars = _keep_stars(target, manifest, folder, Path(scratch))
            for file in manifest.files:
                if file.path.startswith("data/"):
                    progress(_unpack(target, manifest, file, folder, Path(scratch)))
    except GeneratorError as error:
        raise DatasetError(str(error)) from error
    except OSError as error:
        raise DatasetError(f"{place}: cannot be read ({type(error).__name__}: {error})") from error
    return ungraded(open_dataset(folder / UNPACKED, stars), place, manifest.split, digest)


def _fetched(target: Target, place: str, scratch: Path, most: int) -> Path:
    try:
        if isinstance(target, LocalTarget):
            linked_within(target.folder, place)
        found = target.fetch(place, scratch, most)
    except FileNotFoundError:
        found = scratch / place
    if not found.is_file():
        raise DatasetError(
            f"{target.name}: no {place} in it, so it is no finished dataset; run `skybench generate` again"
        )
    return found


def _checked(target: Target, file: StoredFile, scratch: Path) -> Path:
    path = _fetched(target, file.path, scratch, file.bytes)
    if path.suffix == ".tar":
        check_holes(path)
    root = path.parents[len(Path(file.path).parts) - 1]
    if path.stat().st_size != file.bytes or stored_file(root, file.path) != file:
        raise DatasetError(f"{target.name}: {file.path} is not what its manifest says; run `skybench verify`")
    return path


def _keep_stars(target: Target, manifest: Manifest, folder: Path, scratch: Path) -> list[Path]:
    """Copy the tables of stars next to the frames, where the report finds them too."""
    kept = []
    for file in manifest.files:
        if not file.path.startswith("stars/"):
            continue
        path = path_within(folder, file.path)
        if not (path.is_file() and stored_file(folder, file.path) == file):
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(_checked(target, file, scratch), path)
        kept.append(path)
    return kept


def _decoded(frame: StoredFrame, codec: str, name: str) -> NDArray[np.uint16]:
    name = f"{name}: {frame.frame_id}"
    record = read_record(frame.members["json"], name, frame.frame_id)
    try:
        return decode(frame.members[codec], codec, image_shape(record))
    except GeneratorError as error:
        raise DatasetError(f"{name}: {error}") from error


def _unpack(target: Target, manifest: Manifest, file: StoredFile, folder: Path, scratch: Path) -> int:
    """Unpack a shard's images and records into one folder; returns the number of its frames."""
    done, unpacked = folder / "shards" / f"{Path(file.path).stem}.txt", folder / UNPACKED
    if (known := _unpacked_before(done, file.sha256, unpacked)) is not None:
        return known
    path = _checked(target, file, scratch)
    codec: str = manifest.codec
    frame_ids: list[str] = []
    unpacked.mkdir(parents=True, exist_ok=True)
    for frame in read_frames(path):
        if not {codec, "json"} <= set(frame.members):
            raise DatasetError(f"{target.name}: {file.path}: {frame.frame_id} has no image or no record")
        image = frame.members[codec]
        (unpacked / f"{frame.frame_id}.png").write_bytes(
            image if codec == "png" else encode(_decoded(frame, codec, f"{target.name}: {file.path}"), "png")
        )
        (unpacked / f"{frame.frame_id}.json").write_bytes(frame.members["json"])
        frame_ids.append(frame.frame_id)
    # Written last: its presence says that the shard's frames are complete.
    write_bytes(done, "\n".join((file.sha256, *frame_ids)).encode())
    if scratch in path.parents:
        path.unlink()
    return len(frame_ids)


def _unpacked_before(done: Path, sha256: str, unpacked: Path) -> int | None:
    """Number of a shard's frames where all of them are there as an earlier run has unpacked them; None otherwise."""
    try:
        digest, *frame_ids = done.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        return None
    names = [f"{frame_id}.{suffix}" for frame_id in frame_ids for suffix in ("png", "json")]
    whole = digest == sha256 and all((unpacked / name).is_file() for name in names)
    return len(frame_ids) if whole else None
