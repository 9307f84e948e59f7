"""A folder of rendered frames: which of a scenario's frames it holds already, and its tables of truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from generator.errors import GeneratorError
from generator.files import atomic_path
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import STAR_SCHEMA
from generator.imu.table import write_imu_table
from generator.scenario.file import Scenario

STARS_FILE = "stars.parquet"
OBJECTS_FILE = "objects.parquet"
IMU_FILE = "imu.parquet"
"""Readings of the inertial unit of a scenario's sequences."""
UNFINISHED = ".unfinished"
"""Folder inside: tables of single frames, until all frames are there."""
SCHEMAS = {STARS_FILE: STAR_SCHEMA, OBJECTS_FILE: OBJECT_SCHEMA}
_TEMPORARY = (".frame-", ".stars-", ".objects-", ".imu-")
_OWN_PREFIXES = ("frame-", *_TEMPORARY)


class FrameFolder:
    """The folder that `skybench render` writes.

    The tables of truth appear when the last frame is written. Until then each frame's rows lie in a hidden folder, so that
    an interrupted run loses at most the frame being rendered.

    Parameters
    ----------
    folder : Path
    scenario : Scenario
    """

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        self.folder = folder
        self.scenario = scenario

    def open(self, overwrite: bool) -> None:
        """Make the folder, or accept one that holds frames of the same scenario.

        Parameters
        ----------
        overwrite : bool
            Remove existing frames, of any scenario.

        Raises
        ------
        GeneratorError
            The folder cannot be written, or holds other files or another scenario's frames.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            known = (*SCHEMAS, IMU_FILE, UNFINISHED)
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
        # The tables go first: a folder never looks finished while frames are missing.
        for name in (*SCHEMAS, IMU_FILE):
            (self.folder / name).unlink(missing_ok=True)
        shutil.rmtree(self.folder / UNFINISHED, ignore_errors=True)
        for prefix in _OWN_PREFIXES:
            for path in self.folder.glob(f"{prefix}*"):
                path.unlink()

    def _refuse_other_frames(self) -> None:
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
        """Indices of incomplete frames.

        If there are any, finished tables are split into single frames again, so that the folder does not look finished.

        Parameters
        ----------
        exr, layers : bool
            Whether a frame's expected electrons, and those of each layer, belong to it.
        """
        finished = (self.folder / STARS_FILE).is_file()
        indices = range(self.scenario.frame_count)
        incomplete = [index for index in indices if not self._whole(index, exr, layers, finished)]
        if finished and incomplete:
            self._take_apart()
        return incomplete

    def _whole(self, index: int, exr: bool, layers: bool, finished: bool) -> bool:
        stem = frame_id(index)
        suffixes = (".json", ".png", *((".exr",) if exr else ()))
        if not all((self.folder / f"{stem}{suffix}").is_file() for suffix in suffixes):
            return False
        if layers and not any(self.folder.glob(f"{stem}.*.exr")):
            return False
        return finished or self._rows_file(index, STARS_FILE).is_file()

    def _rows_file(self, index: int, table: str) -> Path:
        return self.folder / UNFINISHED / f"{frame_id(index)}.{table}"

    def _take_apart(self) -> None:
        for name in SCHEMAS:
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

    def add(self, index: int, stars: pa.Table, objects: pa.Table) -> None:
        """Keep the truth of a frame whose files are written: rows of STAR_SCHEMA and OBJECT_SCHEMA."""
        if objects.num_rows:
            self._put_rows(index, OBJECTS_FILE, objects)
        self._put_rows(index, STARS_FILE, stars)

    def write_imu(self) -> None:
        """Write the table of the sequences' inertial unit, if the scenario has one and the folder lacks it."""
        if self.scenario.has_imu and not (self.folder / IMU_FILE).is_file():
            write_imu_table(self.folder / IMU_FILE, self.scenario, range(self.scenario.sequence_count))

    def finish(self) -> None:
        """Write the tables of all frames; the stars last, which marks the folder as complete."""
        for name in (OBJECTS_FILE, STARS_FILE):
            tables = list(self._tables(name))
            if tables or name == STARS_FILE:
                _write_table(self.folder / name, pa.concat_tables(tables) if tables else SCHEMAS[name].empty_table())
        shutil.rmtree(self.folder / UNFINISHED)

    def _tables(self, name: str) -> Iterator[pa.Table]:
        for index in range(self.scenario.frame_count):
            path = self._rows_file(index, name)
            if path.is_file():
                yield pq.read_table(path, schema=SCHEMAS[name])


def frame_id(index: int) -> str:
    """Name of a frame in files and tables."""
    return f"frame-{index:05d}"


def _write_table(path: Path, table: pa.Table) -> None:
    with atomic_path(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")
