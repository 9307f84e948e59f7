"""A folder of rendered frames: the frames of a scenario that it already contains, and the tables of truth."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from generator.errors import GeneratorError
from generator.files import atomic_path
from generator.frame.manifest import (
    FRAMES_MANIFEST,
    frame_index,
    read_frame_receipt,
    read_frames_manifest,
    write_frame_receipt,
    write_frames_manifest,
)
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import STAR_SCHEMA
from generator.imu.table import write_imu_table
from generator.scenario.file import Scenario
from generator.stored_files import StoredFile, file_problem, stored_file

STARS_FILE = "stars.parquet"
OBJECTS_FILE = "objects.parquet"
IMU_FILE = "imu.parquet"
"""File with the readings of the inertial unit of a scenario's sequences."""
UNFINISHED = ".unfinished"
"""Subfolder with tables and receipts of single frames, until all frames are complete."""
RECEIPT = "files.json"
SCHEMAS = {STARS_FILE: STAR_SCHEMA, OBJECTS_FILE: OBJECT_SCHEMA}
_LAYER = re.compile(r"\.[^.]+\.exr$")
_TEMPORARY = (".frame-", ".frames-manifest-", ".stars-", ".objects-", ".imu-")
_OWN_PREFIXES = ("frame-", *_TEMPORARY)


class FrameFolder:
    """The folder that `skybench render` writes.

    The tables of truth and the manifest appear when the last frame is written. Until then each frame's rows and the
    hashes of its files are in a hidden folder, so an interrupted run loses at most the frame being rendered. An existing
    manifest remains until a new one is complete.

    Parameters
    ----------
    folder : Path
    scenario : Scenario

    Attributes
    ----------
    mended : list of str
        Files that were missing or had changed, and are written again.
    finished : bool
        Whether everything that belongs to the folder was found intact.
    writes : (bool, bool)
        Whether frames are written with their expected electrons, and with those of each layer.
    """

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        self.folder = folder
        self.scenario = scenario
        self.mended: list[str] = []
        self.finished = False
        self.writes = (False, False)
        self._files: dict[int, list[StoredFile]] = {}
        self._readings_whole = False

    def open(self, overwrite: bool) -> None:
        """Create the folder, or accept one with frames of the same scenario.

        Parameters
        ----------
        overwrite : bool
            Remove existing frames, of any scenario.

        Raises
        ------
        GeneratorError
            The folder cannot be written, or contains other files or another scenario's frames.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            known = (*SCHEMAS, IMU_FILE, FRAMES_MANIFEST, UNFINISHED)
            strangers = [
                path.name
                for path in self.folder.iterdir()
                if path.name not in known and not path.name.startswith(_OWN_PREFIXES)
            ]
            if strangers:
                raise GeneratorError(
                    f"{self.folder}: holds other files ({sorted(strangers)[0]}, …); choose an empty folder"
                )
            if overwrite:
                self._clear()
            else:
                self._refuse_other_frames()
                for prefix in _TEMPORARY:  # left by a killed run
                    for path in self.folder.glob(f"{prefix}*"):
                        path.unlink()
        except OSError as error:
            raise GeneratorError(
                f"{self.folder}: cannot be written ({error.strerror}); choose another folder"
            ) from error

    def _clear(self) -> None:
        # Manifest and tables go first: a folder never looks finished while frames are missing.
        for name in (FRAMES_MANIFEST, *SCHEMAS, IMU_FILE):
            (self.folder / name).unlink(missing_ok=True)
        shutil.rmtree(self.folder / UNFINISHED, ignore_errors=True)
        for prefix in _OWN_PREFIXES:
            for path in self.folder.glob(f"{prefix}*"):
                path.unlink()

    def _refuse_other_frames(self) -> None:
        if self._listed():
            return  # a record of another scenario is a damaged one
        for path in sorted(self.folder.glob("frame-*.json")):
            try:
                found = json.loads(path.read_text(encoding="utf-8"))["scenario"]
                name, digest = str(found["name"]), found["sha256"]
            except (ValueError, KeyError, TypeError) as error:
                raise GeneratorError(
                    f"{path}: not a frame record ({error!r}); choose another folder, or replace its frames with --overwrite"
                ) from error
            if digest != self.scenario.sha256:
                raise GeneratorError(
                    f"{self.folder}: holds frames of another scenario or version ('{name}'); choose another folder, "
                    "or replace them with --overwrite"
                )

    def missing(self, exr: bool, layers: bool) -> list[int]:
        """Indices of incomplete frames: those with a missing or altered file, or with a table that cannot be read.

        If there are any, finished tables are split into single frames again, so that the folder does not look finished.
        Damaged tables are removed, because their rows are written again with the frames. Files that were listed but are
        missing or altered are added to `mended`.

        Parameters
        ----------
        exr, layers : bool
            Whether frames must have their expected electrons, and those of each layer, in addition to what the folder
            contains.
        """
        listed = self._listed()
        intact = {file.path for file in listed if not file_problem(self.folder, file)}
        self.mended += [file.path for file in listed if file.path not in intact]
        if not listed and (self.folder / FRAMES_MANIFEST).exists():
            self.mended.append(FRAMES_MANIFEST)
        tables = {file.path for file in listed if file.path in SCHEMAS}
        finished = STARS_FILE in tables and tables <= intact
        self._files = {}
        for file in listed:
            index = frame_index(file.path)
            if index is not None and index < self.scenario.frame_count:
                self._files.setdefault(index, []).append(file)
        exr |= any(file.path.endswith(".exr") for file in listed)
        layers |= any(_LAYER.search(file.path) for file in listed)
        for index in range(self.scenario.frame_count):
            receipt = read_frame_receipt(self._rows_file(index, RECEIPT))
            if receipt:
                self._files[index] = [file for file in receipt if frame_index(file.path) == index]
                intact |= {file.path for file in receipt if not file_problem(self.folder, file)}
        with_rows = {index for index in range(self.scenario.frame_count) if self._has_rows(index)}
        incomplete = [
            index
            for index in range(self.scenario.frame_count)
            if not (self._whole(index, intact, exr, layers) and (finished or index in with_rows))
        ]
        if not finished:
            for name in (OBJECTS_FILE, STARS_FILE):
                (self.folder / name).unlink(missing_ok=True)
        elif incomplete:
            self._take_apart()
        self.writes = exr, layers
        self.finished = finished and not incomplete
        self._readings_whole = IMU_FILE in intact
        return incomplete

    def _listed(self) -> tuple[StoredFile, ...]:
        """Files of the manifest that exist in the folder; empty if it has no manifest of this scenario."""
        try:
            manifest = read_frames_manifest(self.folder)
        except GeneratorError:
            return ()
        return manifest.files if manifest.scenario_sha256 == self.scenario.sha256 else ()

    def _whole(self, index: int, intact: set[str], exr: bool, layers: bool) -> bool:
        stem = frame_id(index)
        places = {file.path for file in self._files.get(index, [])}
        if not places <= intact:
            return False
        suffixes = (".json", ".png", *((".exr",) if exr else ()))
        return places >= {f"{stem}{suffix}" for suffix in suffixes} and (
            not layers or any(_LAYER.search(place) for place in places)
        )

    def _rows_file(self, index: int, table: str) -> Path:
        return self.folder / UNFINISHED / f"{frame_id(index)}.{table}"

    def _has_rows(self, index: int) -> bool:
        """Whether a frame's own tables are there; if one of them cannot be read, they are removed, to be made again."""
        try:
            for name in SCHEMAS:
                if self._rows_file(index, name).is_file():
                    self._rows(index, name).validate(full=True)
        except (OSError, pa.ArrowException, ValueError, TypeError, LookupError):
            # A frame without objects has no table of them, so the rows of the stars go first: they make a frame complete.
            for name in (STARS_FILE, OBJECTS_FILE):
                self._rows_file(index, name).unlink(missing_ok=True)
        return self._rows_file(index, STARS_FILE).is_file()

    def _rows(self, index: int, name: str) -> pa.Table:
        return pq.read_table(self._rows_file(index, name), schema=SCHEMAS[name])

    def _take_apart(self) -> None:
        for name in (OBJECTS_FILE, STARS_FILE):  # the rows of the stars come last, because they make a frame complete
            path = self.folder / name
            if not path.is_file():
                continue
            table = pq.read_table(path)
            for index in range(self.scenario.frame_count):
                rows = table.filter(pc.equal(table["index"], index))
                if rows.num_rows or name == STARS_FILE:
                    self._put_rows(index, name, rows)
            path.unlink()

    def _put_rows(self, index: int, name: str, rows: pa.Table) -> None:
        path = self._rows_file(index, name)
        path.parent.mkdir(exist_ok=True)
        _write_table(path, rows)

    def add(self, index: int, stars: pa.Table, objects: pa.Table, written: Collection[str]) -> None:
        """Store the truth of a frame whose files are written: rows of STAR_SCHEMA and OBJECT_SCHEMA, and the files' names."""
        if objects.num_rows:
            self._put_rows(index, OBJECTS_FILE, objects)
        self._put_rows(index, STARS_FILE, stars)
        self._files[index] = [stored_file(self.folder, place) for place in sorted(written)]
        write_frame_receipt(self._rows_file(index, RECEIPT), self._files[index])

    def finish(self) -> None:
        """Write the tables of all frames, and the manifest last, which marks the folder as complete.

        A complete folder is left unchanged.
        """
        if not self.finished:
            for name in (OBJECTS_FILE, STARS_FILE):
                tables = list(self._tables(name))
                if tables or name == STARS_FILE:
                    _write_table(
                        self.folder / name, pa.concat_tables(tables) if tables else SCHEMAS[name].empty_table()
                    )
        names = [name for name in SCHEMAS if (self.folder / name).is_file()]
        if self.scenario.has_imu:
            if not self._readings_whole:
                write_imu_table(self.folder / IMU_FILE, self.scenario, range(self.scenario.sequence_count))
            names.append(IMU_FILE)
        files = [file for own in self._files.values() for file in own]
        files += [stored_file(self.folder, name) for name in names]
        if set(files) != set(self._listed()):
            write_frames_manifest(self.folder, self.scenario, files)
        if (self.folder / UNFINISHED).exists():
            shutil.rmtree(self.folder / UNFINISHED)

    def _tables(self, name: str) -> Iterator[pa.Table]:
        for index in range(self.scenario.frame_count):
            if self._rows_file(index, name).is_file():
                yield self._rows(index, name)


def frame_id(index: int) -> str:
    """Name of a frame in files and tables."""
    return f"frame-{index:05d}"


def _write_table(path: Path, table: pa.Table) -> None:
    with atomic_path(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")
