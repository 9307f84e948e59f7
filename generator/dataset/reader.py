"""Reading datasets back: tables, and the members of the shards."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from generator.dataset.frame_columns import FRAME_SCHEMA
from generator.dataset.manifest import Manifest, read_manifest
from generator.errors import GeneratorError
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import STAR_SCHEMA

LARGEST_MEMBER_BYTES = 2_000_000_000


@dataclass(frozen=True)
class StoredFrame:
    """One frame as it is stored: its name, and its members' bytes by suffix (``png``, ``json``, …)."""

    frame_id: str
    members: dict[str, bytes]


@dataclass(frozen=True)
class Dataset:
    """A finished dataset on disk."""

    folder: Path
    manifest: Manifest

    @classmethod
    def open(cls, folder: Path) -> Dataset:
        """Open a dataset by its manifest. Raises GeneratorError."""
        return cls(folder, read_manifest(folder))

    def paths(self, table: str) -> list[Path]:
        """Files of a table (one of TABLES) or of the images (``data``), in the order of the shards."""
        return [self.folder / file.path for file in self.manifest.files if file.path.startswith(f"{table}/")]

    def frames(self) -> pa.Table:
        """The table of frames."""
        return _read(self.paths("frames"), FRAME_SCHEMA)

    def stars(self) -> pa.Table:
        """The table of stars."""
        return _read(self.paths("stars"), STAR_SCHEMA)

    def objects(self) -> pa.Table:
        """The table of flying objects and the Moon."""
        return _read(self.paths("objects"), OBJECT_SCHEMA)

    def stored_frames(self) -> Iterator[StoredFrame]:
        """All frames in order, as stored.

        Raises
        ------
        GeneratorError
            An archive is damaged, or a member larger than any image.
        """
        for path in self.paths("data"):
            try:
                with tarfile.open(path, "r:") as archive:
                    yield from _grouped(archive, path)
            except (tarfile.TarError, OSError) as error:
                raise GeneratorError(f"{path}: damaged ({error}); run `skybench verify`") from error


def _grouped(archive: tarfile.TarFile, path: Path) -> Iterator[StoredFrame]:
    current: StoredFrame | None = None
    for member in archive:
        stem, _, suffix = member.name.partition(".")
        stream = archive.extractfile(member) if member.isfile() and member.size <= LARGEST_MEMBER_BYTES else None
        if stream is None:
            raise GeneratorError(f"{path}: has a member that no dataset has: {member.name}")
        if current is None or current.frame_id != stem:
            if current is not None:
                yield current
            current = StoredFrame(stem, {})
        current.members[suffix] = stream.read()
    if current is not None:
        yield current


def _read(paths: list[Path], schema: pa.Schema) -> pa.Table:
    try:
        return pa.concat_tables([pq.read_table(path) for path in paths]) if paths else schema.empty_table()
    except (OSError, pa.ArrowException) as error:
        raise GeneratorError(f"{paths[0].parent}: a table is damaged ({error}); run `skybench verify`") from error
