"""Reading finished datasets: the tables, and the frames in the shards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from generator.dataset.archive import StoredFrame, read_frames
from generator.dataset.frame_columns import FRAME_SCHEMA
from generator.dataset.manifest import Manifest, read_manifest
from generator.errors import GeneratorError
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import STAR_SCHEMA


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
            An archive is damaged, or has a member that the format does not allow.
        """
        for path in self.paths("data"):
            yield from read_frames(path)


def _read(paths: list[Path], schema: pa.Schema) -> pa.Table:
    try:
        return pa.concat_tables([pq.read_table(path) for path in paths]) if paths else schema.empty_table()
    except (OSError, pa.ArrowException) as error:
        raise GeneratorError(f"{paths[0].parent}: a table is damaged ({error}); run `skybench verify`") from error
