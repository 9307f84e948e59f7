"""The twins as a dataset: image, record and stars of each, as `skybench render` writes them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmark.errors import PhotographError
from benchmark.twin.twin import Twin
from generator import __version__
from generator.files import atomic_path, write_bytes
from generator.frame.folder import OBJECTS_FILE, STARS_FILE, frame_id
from generator.frame.manifest import FRAMES_MANIFEST, FramesManifest, write_manifest
from generator.frame.record import frame_record, record_bytes
from generator.frame.render import write_frame
from generator.stored_files import StoredFile, stored_file

FRAMES = "frames"
"""Folder of the dataset in that of the twins."""
NAME = "twins"
"""Name of the dataset, used like a scenario's."""


class TruthFolder:
    """A folder of frames, one per twin, that is complete after each of them.

    Every twin has a scenario of its own; its name, hash and seed are in the record's section ``twin``. The section
    ``scenario``, which all frames of a dataset share, states the hash of them all and of what solvers receive.

    Parameters
    ----------
    folder : Path
        A new or empty folder, or one with earlier twins, which are replaced by the first new one.

    Raises
    ------
    PhotographError
        The folder holds other files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._records: list[dict[str, Any]] = []
        self._files: list[StoredFile] = []
        self._tables: dict[str, list[pa.Table]] = {STARS_FILE: [], OBJECTS_FILE: []}
        self._check()

    def add(self, twin: Twin) -> None:
        """Write a twin's frame, and the tables and the manifest of all that there are.

        Raises
        ------
        PhotographError
            Writing failed.
        """
        index = len(self._records)
        made = twin.frame
        plan = dataclasses.replace(made.plan, index=index)
        stars, objects = (_numbered(table, index) for table in (made.stars, made.objects))
        frame = dataclasses.replace(made, plan=plan, stars=stars, objects=objects)
        record = frame_record(plan, frame.expected, stars)
        record["twin"] = {"photograph": twin.photograph.name, "scenario": record["scenario"]}
        if twin.photograph.told is not None:
            record["told"] = twin.photograph.told
        try:
            if not self._records:
                self._clear()
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / FRAMES_MANIFEST).unlink(missing_ok=True)
            written = write_frame(self.folder, frame, exr=False)
            self._files += [stored_file(self.folder, name) for name in written if name != _record_file(index)]
            self._records.append(record)
            self._tables[STARS_FILE].append(stars)
            if objects.num_rows:
                self._tables[OBJECTS_FILE].append(objects)
            self._finish()
        except OSError as error:
            raise PhotographError(
                f"{error.filename or self.folder}: writing failed ({error.strerror or error}); free some space, or choose "
                "another --out"
            ) from error

    def _finish(self) -> None:
        """Write records, tables and, last, the manifest."""
        parts = [[record["twin"], record.get("told")] for record in self._records]
        identity = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
        files = list(self._files)
        for index, record in enumerate(self._records):
            shared = {"name": NAME, "sha256": identity, "seed": 0}
            write_bytes(self.folder / _record_file(index), record_bytes(record | {"scenario": shared}))
            files.append(stored_file(self.folder, _record_file(index)))
        for name, tables in self._tables.items():
            if tables:
                with atomic_path(self.folder / name) as temporary:
                    pq.write_table(pa.concat_tables(tables), temporary, compression="zstd")
                files.append(stored_file(self.folder, name))
        listed = tuple(sorted(files, key=lambda file: file.path))
        write_manifest(self.folder, FramesManifest(NAME, identity, 0, __version__, len(self._records), listed))

    def _check(self) -> None:
        """Refuse a folder with anything but earlier twins."""
        if not self.folder.exists():
            return
        try:
            found = sorted(self.folder.iterdir())
            own = all(_is_twin(path) for path in found if path.suffix == ".json" and path.name != FRAMES_MANIFEST)
            twins = own and (self.folder / _record_file(0)).is_file()
            strangers = [path.name for path in found if not (twins and _is_of_dataset(path))]
        except OSError as error:
            raise PhotographError(f"{self.folder}: cannot be read ({error.strerror}); choose another --out") from error
        if strangers:
            raise PhotographError(
                f"{self.folder}: holds other files than twins ({strangers[0]}, …); choose another --out, or remove them"
            )

    def _clear(self) -> None:
        """Remove earlier twins, the manifest first: a folder never looks complete while frames are missing."""
        if self.folder.exists():
            for path in sorted(self.folder.iterdir(), key=lambda path: path.name != FRAMES_MANIFEST):
                path.unlink()


def _record_file(index: int) -> str:
    return f"{frame_id(index)}.json"


def _numbered(table: pa.Table, index: int) -> pa.Table:
    """The rows of a frame as those of another index."""
    columns = {
        "index": pa.array(np.full(table.num_rows, index, dtype=np.int32)),
        "frame_id": pa.repeat(frame_id(index), table.num_rows),
    }
    for name, column in columns.items():
        place = table.schema.get_field_index(name)
        table = table.set_column(place, table.schema.field(place), column)
    return table


def _is_of_dataset(path: Path) -> bool:
    """Whether a file belongs to a dataset, by its name."""
    return path.name in (STARS_FILE, OBJECTS_FILE, FRAMES_MANIFEST) or path.name.startswith("frame-")


def _is_twin(path: Path) -> bool:
    """Whether a file is the record of a twin."""
    try:
        return "twin" in json.loads(path.read_bytes())
    except (ValueError, TypeError, RecursionError):
        return False
