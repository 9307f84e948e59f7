"""Sources of `skybench show`: a dataset in shards, or a folder that `skybench render` wrote."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from generator.dataset.frame_columns import frame_row
from generator.dataset.images import decode, picture
from generator.dataset.layout import MANIFEST
from generator.dataset.reader import Dataset
from generator.errors import GeneratorError
from generator.files import read_at_most
from generator.frame.folder import OBJECTS_FILE, STARS_FILE
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import LATER_STAR_COLUMNS, STAR_SCHEMA
from generator.reading.record import LARGEST_RECORD_BYTES, read_record
from generator.reading.stars import read_stars
from generator.reading.table import read_table


class Source(Protocol):
    """Frames to show.

    Attributes
    ----------
    scenario, scenario_sha256, made_with : str
    frames : DataFrame
        One row per frame, by index; at least the requested columns of generator.dataset.frame_columns.FRAME_SCHEMA.
    """

    @property
    def scenario(self) -> str:
        """Name of the scenario."""

    @property
    def scenario_sha256(self) -> str:
        """Hash of the scenario."""

    @property
    def frames(self) -> pd.DataFrame:
        """Conditions of all frames."""

    def image(self, position: int) -> NDArray[np.uint16]:
        """DN of the frame in row `position` of `frames`, (height, width)."""

    def developed(self, position: int) -> NDArray[np.uint8] | None:
        """Developed picture, (height, width) or (height, width, 3); None where the scenario does not request one."""

    def record(self, position: int) -> dict[str, Any]:
        """Frame record."""

    def stars(self, position: int) -> pd.DataFrame:
        """Truth of stars and planets."""

    def objects(self, position: int) -> pd.DataFrame:
        """Truth of flying objects and the Moon."""


def open_source(folder: Path, columns: Collection[str] = ()) -> Source:
    """Open a dataset or a folder of frames.

    Parameters
    ----------
    folder : Path
    columns : collection of str
        Columns of the table of frames that are needed besides ``frame_id``; a dataset may have many frames.

    Raises
    ------
    GeneratorError
        There is neither of them, or it is unfinished or damaged.
    """
    if (folder / MANIFEST).is_file():
        return ShardSource.open(folder, columns)
    if (folder / STARS_FILE).is_file():
        return FolderSource.open(folder)
    raise GeneratorError(
        f"{folder}: holds neither {MANIFEST} nor {STARS_FILE}, so it is no finished dataset; "
        "make one with `skybench generate` or `skybench render`"
    )


@dataclass(frozen=True)
class ShardSource:
    """A dataset that `skybench generate` wrote."""

    dataset: Dataset
    scenario: str
    scenario_sha256: str
    frames: pd.DataFrame

    @classmethod
    def open(cls, folder: Path, columns: Collection[str] = ()) -> "ShardSource":
        """Open a dataset by its manifest. Raises GeneratorError."""
        dataset = Dataset.open(folder)
        frames = dataset.frames(("frame_id", *columns)).to_pandas()
        return cls(dataset, dataset.manifest.scenario, dataset.manifest.scenario_sha256, frames)

    def image(self, position: int) -> NDArray[np.uint16]:
        """DN of a frame."""
        return self.dataset[position].image

    def developed(self, position: int) -> NDArray[np.uint8] | None:
        """Developed picture of a frame."""
        return self.dataset[position].developed

    def record(self, position: int) -> dict[str, Any]:
        """Record of a frame."""
        return self.dataset[position].record

    def stars(self, position: int) -> pd.DataFrame:
        """Truth of stars."""
        return self.dataset[position].stars.to_pandas()

    def objects(self, position: int) -> pd.DataFrame:
        """Truth of objects."""
        return self.dataset[position].objects.to_pandas()


@dataclass(frozen=True)
class FolderSource:
    """A folder that `skybench render` wrote."""

    folder: Path
    scenario: str
    scenario_sha256: str
    frames: pd.DataFrame
    all_stars: pd.DataFrame
    all_objects: pd.DataFrame

    @classmethod
    def open(cls, folder: Path) -> "FolderSource":
        """Read all frame records and truth tables. Raises GeneratorError."""
        rows = [_record_row(path) for path in sorted(folder.glob("frame-*.json"))]
        if not rows:
            raise GeneratorError(f"{folder}: no frame-*.json in it; make frames with `skybench render`")
        frames = pd.DataFrame(rows).sort_values("index", ignore_index=True)
        return cls(
            folder,
            str(frames["scenario"].iloc[0]),
            str(frames["scenario_sha256"].iloc[0]),
            frames,
            _stars(folder / STARS_FILE),
            _truth(folder / OBJECTS_FILE, OBJECT_SCHEMA) if (folder / OBJECTS_FILE).is_file() else pd.DataFrame(),
        )

    def image(self, position: int) -> NDArray[np.uint16]:
        """DN of a frame."""
        path = self.folder / str(self.frames.iloc[position]["image"])
        with damage_named(path):
            return decode(path.read_bytes(), "png", self._shape(position))

    def developed(self, position: int) -> NDArray[np.uint8] | None:
        """Developed picture of a frame."""
        path = self.folder / f"{self.frames.iloc[position]['frame_id']}-developed.png"
        if not path.is_file():
            return None
        with damage_named(path):
            return picture(path.read_bytes(), self._shape(position))

    def record(self, position: int) -> dict[str, Any]:
        """Record of a frame."""
        path = self.folder / f"{self.frames.iloc[position]['frame_id']}.json"
        with damage_named(path):
            return read_record(read_at_most(path, LARGEST_RECORD_BYTES), str(path), path.stem)

    def stars(self, position: int) -> pd.DataFrame:
        """Truth of stars."""
        return self._of(self.all_stars, position)

    def objects(self, position: int) -> pd.DataFrame:
        """Truth of objects."""
        return self._of(self.all_objects, position)

    def _shape(self, position: int) -> tuple[int, int]:
        row = self.frames.iloc[position]
        return int(row["height_px"]), int(row["width_px"])

    def _of(self, table: pd.DataFrame, position: int) -> pd.DataFrame:
        return table if table.empty else table[table["index"] == self.frames.iloc[position]["index"]]


def _record_row(path: Path) -> dict[str, Any]:
    with damage_named(path):
        record = read_record(read_at_most(path, LARGEST_RECORD_BYTES), str(path), path.stem)
        return frame_row(record, "", "", f"{path.stem}.png", b"")


def _stars(path: Path) -> pd.DataFrame:
    """Read the truth of stars; a star of a photograph not known to be hidden or saturated counts as neither."""
    with damage_named(path):
        stars = read_stars(path, STAR_SCHEMA, needed=set(STAR_SCHEMA.names) - LATER_STAR_COLUMNS).to_pandas()
    return stars.assign(**{name: stars[name].eq(True) for name in ("saturated", "occluded")})


def _truth(path: Path, schema: pa.Schema) -> pd.DataFrame:
    with damage_named(path):
        return read_table(path, schema, needed=schema.names).to_pandas()


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Convert whatever reading someone else's file can raise to one line with the file's name."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, SyntaxError, pa.ArrowException) as error:
        raise GeneratorError(f"{path}: cannot be read ({type(error).__name__}: {error}); make it again") from error
