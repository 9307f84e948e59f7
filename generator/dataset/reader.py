"""Read finished datasets: tables, and frames with their image at full depth, record and truth.

A dataset has a length and can be indexed, so PyTorch's ``DataLoader`` accepts it directly or through :meth:`Dataset.map`;
docs/exports.md shows this and other libraries.

Examples
--------
>>> dataset = Dataset.open("out/set")  # or a URL such as "s3://bucket/set"
>>> frame = dataset[3]
>>> frame.image.dtype, frame.record["camera"]["f_px"], frame.stars.num_rows
(dtype('uint16'), 232.0, 412)
"""

from __future__ import annotations

import functools
import hashlib
import tempfile
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import platformdirs
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from generator.dataset.archive import Place, StoredFrame, check_sizes, frame_places, read_frames, read_place
from generator.dataset.frame_columns import FRAME_SCHEMA
from generator.dataset.images import PHOTOS, decode, photo, picture
from generator.dataset.layout import CODECS, IMU, MANIFEST, TABLES
from generator.dataset.manifest import Manifest, read_manifest
from generator.dataset.target import open_target
from generator.errors import GeneratorError
from generator.files import linked_within, write_bytes
from generator.frame.manifest import FRAMES_MANIFEST
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import STAR_SCHEMA
from generator.imu.table import IMU_SCHEMA
from generator.reading.png_header import check_png
from generator.reading.record import image_shape, read_record
from generator.reading.table import read_table
from generator.stored_files import LARGEST_MANIFEST_BYTES, StoredFile, stored_file

Sample = TypeVar("Sample")
NEVER_NULL = ("index", "frame_id", "scenario", "scenario_sha256", "width_px", "height_px", "shard", "image")
"""Columns of the table of frames that are never empty."""
SCHEMAS = {"frames": FRAME_SCHEMA, "stars": STAR_SCHEMA, "objects": OBJECT_SCHEMA, IMU: IMU_SCHEMA}


@dataclass(frozen=True)
class ShardFrame:
    """A frame of an archive; its files are decoded when they are first accessed.

    Attributes
    ----------
    frame_id : str
    members : dict of str to bytes
        Files as stored, by suffix: ``png`` or ``jxl``, ``json``, and if the dataset has them ``exr``, ``developed.png``,
        ``hud.png``, ``mask.png``, ``photo.jpg`` or ``photo.heic``, ``stack.fits``, ``video.mp4``.
    path : Path
        The archive, for messages.
    """

    frame_id: str
    members: dict[str, bytes]
    path: Path

    @functools.cached_property
    def image(self) -> NDArray[np.uint16]:
        """DN, (height, width) uint16 array; for a colour sensor, the raw mosaic. Raises GeneratorError."""
        for codec in CODECS:
            if codec in self.members:
                with _Damage(self):
                    return decode(self.members[codec], codec, image_shape(self.record))
        raise GeneratorError(f"{self.path}: {self.frame_id} has no image; run `skybench verify`")

    @functools.cached_property
    def record(self) -> dict[str, Any]:
        """The frame record. Raises GeneratorError."""
        with _Damage(self):
            return read_record(self.members["json"], f"{self.path}: {self.frame_id}", self.frame_id)

    @property
    def index(self) -> int:
        """Index of the frame in its scenario."""
        return int(self.record["index"])

    @functools.cached_property
    def developed(self) -> NDArray[np.uint8] | None:
        """The developed picture, (height, width) or (height, width, 3); None if the scenario does not request one."""
        return self._picture("developed.png")

    @functools.cached_property
    def hud(self) -> NDArray[np.uint8] | None:
        """255 where the head-up display covers the frame, (height, width); None if there is no display."""
        return self._picture("hud.png")

    @functools.cached_property
    def mask(self) -> NDArray[np.uint8] | None:
        """Cover of the sky, (height, width): 255 for pixels without sky, 0 for sky alone; None without a foreground."""
        return self._picture("mask.png")

    @functools.cached_property
    def photo(self) -> NDArray[np.uint8] | None:
        """Pixels of the photograph's file, (height, width) or (height, width, 3); None if there is none."""
        stored = [self.members[suffix] for suffix in PHOTOS if suffix in self.members]
        if not stored:
            return None
        with _Damage(self):
            return photo(stored[0], image_shape(self.record))

    def file(self, suffix: str) -> bytes:
        """A member as stored; a PNG must have the camera's size. Raises GeneratorError."""
        if suffix.endswith("png"):
            with _Damage(self):
                check_png(self.members[suffix], image_shape(self.record))
        return self.members[suffix]

    def _picture(self, suffix: str) -> NDArray[np.uint8] | None:
        if suffix not in self.members:
            return None
        with _Damage(self):
            return picture(self.members[suffix], image_shape(self.record))


@dataclass(frozen=True)
class Frame(ShardFrame):
    """A frame of a dataset; its rows of the tables are read when they are first accessed.

    Attributes
    ----------
    truth : callable
        Returns the rows of a table (``stars``, ``objects``) for a frame's index.
    """

    truth: Callable[[str, int], pa.Table]

    @functools.cached_property
    def stars(self) -> pa.Table:
        """The frame's rows of the table of stars (``.to_pandas()`` converts them to a data frame). Raises GeneratorError."""
        return self.truth("stars", self.index)

    @functools.cached_property
    def objects(self) -> pa.Table:
        """The frame's rows of the table of objects. Raises GeneratorError."""
        return self.truth("objects", self.index)


@dataclass(frozen=True)
class Dataset:
    """A finished dataset: a sequence of frames, and their tables.

    Attributes
    ----------
    folder : Path
        Folder of its files, or of the cache for files fetched from `url`.
    manifest : Manifest
    url : str
        Empty for a dataset on this machine.
    """

    folder: Path
    manifest: Manifest
    url: str = ""

    @classmethod
    def open(cls, place: str | Path, cache: Path | None = None) -> Dataset:
        """Open a dataset by its manifest.

        Parameters
        ----------
        place : str or Path
            The argument of `skybench generate --out`: a folder, or a URL that fsspec supports.
        cache : Path, optional
            Folder for the files of a URL, each fetched when it is first needed and compared with the manifest's SHA-256;
            by default the user's cache folder.

        Raises
        ------
        GeneratorError
            The dataset cannot be reached, or is not finished.
        """
        if "://" not in str(place):
            folder = Path(place)
            if not folder.is_dir():
                raise GeneratorError(f"{folder}: no such folder")
            if (folder / FRAMES_MANIFEST).is_file():
                raise GeneratorError(
                    f"{folder}: holds frames of `skybench render`; a dataset is what `skybench generate` writes"
                )
            return cls(folder, read_manifest(folder))
        try:
            content = open_target(str(place)).read(MANIFEST, LARGEST_MANIFEST_BYTES)
        except OSError as error:
            raise GeneratorError(f"{place}/{MANIFEST}: cannot be read ({error.strerror or error})") from error
        if content is None:
            raise GeneratorError(f"{place}/{MANIFEST}: missing; the run is unfinished: run `skybench generate` again")
        kept = cache or platformdirs.user_cache_path("skybench") / "datasets"
        folder = kept / hashlib.sha256(content).hexdigest()[:16]
        write_bytes(folder / MANIFEST, content)
        return cls(folder, read_manifest(folder), str(place))

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, position: int) -> Frame:
        """Return a frame by its position in the dataset, from 0; negative numbers count from the end."""
        stem, image = self._places[position]
        frame_id = image.partition(".")[0]
        path = self._file("data", stem)
        places = _indexed(path, *_state(path)).get(frame_id)
        if places is None:
            raise GeneratorError(f"{path}: {frame_id} is missing; run `skybench verify`")
        record = {"json": read_place(path, places["json"])} if "json" in places else {}
        check_sizes(path, frame_id, {suffix: place.size for suffix, place in places.items()}, record.get("json"))
        members = record | {suffix: read_place(path, place) for suffix, place in places.items() if suffix != "json"}
        return self._frame(StoredFrame(frame_id, members), path)

    def __iter__(self) -> Iterator[Frame]:
        """Yield all frames in order, reading each shard once."""
        for file in self._listed("data"):
            yield from self.shard(Path(file.path).stem)

    def shard(self, stem: str) -> Iterator[Frame]:
        """Yield the frames of one shard, such as ``shard-000000``, in order. Raises GeneratorError."""
        path = self._file("data", stem)
        for stored in read_frames(path):
            yield self._frame(stored, path)

    def map(self, function: Callable[[Frame], Sample]) -> MappedDataset[Sample]:
        """Return the dataset with each frame replaced by the result of `function`, computed on access."""
        return MappedDataset(self, function)

    def paths(self, table: str) -> list[Path]:
        """Files of a table (one of TABLES, or IMU) or of the images (``data``), in the order of the shards."""
        return [self.local(file) for file in self._listed(table)]

    def table(self, name: str, columns: Collection[str] | None = None) -> pa.Table:
        """Return the table ``frames``, ``stars``, ``objects`` or ``imu``, or those of the given columns that exist.

        Other columns are not read, which saves memory.

        Raises
        ------
        GeneratorError
            A part is damaged or missing.
        """
        if columns is None:
            parts = [_table(name, path, *_state(path)) for path in self.paths(name)]
        else:
            parts = [checked_table(name, path, columns=columns) for path in self.paths(name)]
        try:
            return pa.concat_tables(parts) if parts else SCHEMAS[name].empty_table()
        except pa.ArrowException as error:
            raise GeneratorError(f"{self.folder / name}: its parts differ ({error}); run `skybench verify`") from error

    def frames(self, columns: Collection[str] | None = None) -> pa.Table:
        """The table of frames, or some of its columns."""
        return self.table("frames", columns)

    def stars(self) -> pa.Table:
        """The table of stars."""
        return self.table("stars")

    def objects(self) -> pa.Table:
        """The table of flying objects, the Moon and cosmic rays."""
        return self.table("objects")

    def imu(self) -> pa.Table:
        """The table of the sequences' inertial unit; without rows if the scenario has none."""
        return self.table(IMU)

    def stored_frames(self) -> Iterator[StoredFrame]:
        """Yield all frames in order, as stored.

        Raises
        ------
        GeneratorError
            An archive is damaged, or has a member that the format does not allow.
        """
        for path in self.paths("data"):
            yield from read_frames(path)

    @functools.cached_property
    def _places(self) -> list[tuple[str, str]]:
        """Shard and name of the image of each frame."""
        table = self.frames(("shard", "image"))
        try:
            return list(zip(table["shard"].to_pylist(), table["image"].to_pylist(), strict=True))
        except KeyError as error:
            raise GeneratorError(f"{self.folder}/frames: column {error} is missing; run `skybench verify`") from error

    def _listed(self, table: str) -> list[StoredFile]:
        return [file for file in self.manifest.files if file.path.startswith(f"{table}/")]

    def _file(self, table: str, stem: str) -> Path:
        """Return a shard's file, which the manifest must list."""
        file = self._by_shard.get((table, stem))
        if file is None:
            raise GeneratorError(f"{self.folder}: the manifest lists no {table} of {stem}; run `skybench verify`")
        return self.local(file)

    @functools.cached_property
    def _by_shard(self) -> dict[tuple[str, str], StoredFile]:
        """The manifest's files by table and shard."""
        return {(Path(file.path).parts[0], Path(file.path).stem): file for file in self.manifest.files}

    def local(self, file: StoredFile) -> Path:
        """Return the local path of a file in the manifest, fetched if necessary. Raises GeneratorError."""
        path = linked_within(self.folder, file.path)
        if not self.url or path.is_file():
            return path
        try:
            with tempfile.TemporaryDirectory(dir=self.folder, prefix=".fetching-") as scratch:
                found = open_target(self.url).fetch(file.path, Path(scratch), file.bytes)
                if stored_file(Path(scratch), file.path) != file:
                    raise GeneratorError(f"{self.url}: {file.path} is not what its manifest says; it is not used")
                path.parent.mkdir(parents=True, exist_ok=True)
                found.replace(path)
        except OSError as error:
            raise GeneratorError(f"{self.url}: {file.path} cannot be fetched ({error}); try again") from error
        return path

    def _frame(self, stored: StoredFrame, path: Path) -> Frame:
        return Frame(stored.frame_id, stored.members, path, functools.partial(self._rows, path.stem))

    def _rows(self, stem: str, table: str, index: int) -> pa.Table:
        path = self._file(table, stem)
        whole = _table(table, path, *_state(path))
        missing = set(SCHEMAS[table].names) - set(whole.schema.names)
        if missing:
            raise GeneratorError(
                f"{path}: column {min(missing)} is missing; the dataset is of an earlier version or damaged: "
                "generate it again from its scenario.yaml"
            )
        return whole.filter(pc.equal(whole["index"], index))


@dataclass(frozen=True)
class MappedDataset(Generic[Sample]):
    """Frames of a dataset, each passed through a function; see :meth:`Dataset.map`."""

    dataset: Dataset
    function: Callable[[Frame], Sample]

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, position: int) -> Sample:
        return self.function(self.dataset[position])


def read_shard(path: str | Path) -> Iterator[ShardFrame]:
    """Yield the frames of a single archive in order: images and records, without the tables of a dataset.

    Raises
    ------
    GeneratorError
        The archive is damaged, or has a member that the format does not allow.
    """
    for stored in read_frames(Path(path)):
        yield ShardFrame(stored.frame_id, stored.members, Path(path))


def decode_member(key: str, data: bytes) -> NDArray[Any] | dict[str, Any] | None:
    """Decode one file of a frame by its suffix, for ``webdataset.WebDataset(…).decode(decode_member)``.

    webdataset's own decoders (``"pil"``, ``"rgb"``, ``"torch"``, …) reduce 16-bit images to 8 bits.

    Parameters
    ----------
    key : str
        Suffix, with or without a leading dot.
    data : bytes

    Returns
    -------
    array, dict or None
        uint16 (height, width) for ``png`` and ``jxl``, uint8 for ``developed.png``, ``hud.png``, ``mask.png`` and
        ``photo.jpg`` or ``photo.heic``, the record for ``json``; None for others, which webdataset then leaves unchanged.

    Raises
    ------
    GeneratorError
        The file is damaged, or not a record.
    """
    suffix = key.lstrip(".")
    if suffix in CODECS:
        return decode(data, suffix)
    if suffix in ("developed.png", "hud.png", "mask.png"):
        return picture(data)
    if suffix in PHOTOS:
        return photo(data)
    return read_record(data, key) if suffix == "json" else None


class _Damage:
    """Context that converts any error from decoding a foreign file to one line with its names."""

    def __init__(self, frame: ShardFrame) -> None:
        self.frame = frame

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        name = f"{self.frame.path}: {self.frame.frame_id}"
        if isinstance(error, GeneratorError) and str(error).startswith(name):
            return
        if isinstance(error, Exception):
            words = str(error) if isinstance(error, GeneratorError) else f"{type(error).__name__}: {error}"
            raise GeneratorError(f"{name} is damaged ({words}); run `skybench verify`") from error


def _state(path: Path) -> tuple[int, int]:
    """Return the properties that change with a file: size and modification time."""
    try:
        found = path.stat()
    except OSError as error:
        raise GeneratorError(f"{path}: {error.strerror}; run `skybench verify`") from error
    return found.st_size, found.st_mtime_ns


@functools.lru_cache(maxsize=64)
def _indexed(path: Path, size: int, changed_ns: int) -> dict[str, dict[str, Place]]:
    return frame_places(path)


def checked_table(
    name: str, path: Path, most_rows: int | None = None, columns: Collection[str] | None = None
) -> pa.Table:
    """Read a part of a table (one of SCHEMAS) or some of its columns, as stored. Raises GeneratorError."""
    needed = NEVER_NULL if name == "frames" else ("index",) if name in TABLES else ()
    try:
        return read_table(
            path,
            SCHEMAS[name],
            needed=needed,
            columns=columns,
            never_null=NEVER_NULL if name == "frames" else (),
            most_rows=most_rows,
        )
    except GeneratorError as error:
        raise GeneratorError(f"{error}; run `skybench verify`") from error


@functools.lru_cache(maxsize=8)
def _table(name: str, path: Path, size: int, changed_ns: int) -> pa.Table:
    return checked_table(name, path)
