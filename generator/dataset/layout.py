"""Names and places of a dataset's files, and the division of its frames into shards."""

from __future__ import annotations

import math
from dataclasses import dataclass

from generator.errors import GeneratorError
from generator.scenario.file import Scenario

MANIFEST = "manifest.json"
SCENARIO_COPY = "scenario.yaml"
CARD = "README.md"
CROISSANT = "croissant.json"
FIGURES = "card"
DEFAULT_SHARD_SIZE = 100
SHARDS_OF_A_SMALL_SET = 32
"""Number of processes that can share a set of fewer than 32 times 100 frames."""
CODECS = ("png", "jxl")
TABLES = ("frames", "stars", "objects")
"""Tables of a dataset; each is a folder of Parquet files, one per shard."""
IMU = "imu"
"""Table of the inertial unit of sequences, a folder of Parquet files, one per sequence."""


@dataclass(frozen=True)
class DatasetSpec:
    """Options of a dataset, in addition to its scenario.

    Attributes
    ----------
    split : str
        Name of the split, a folder under ``data``.
    shard_size : int
        Frames per shard.
    exr : bool
        Whether the expected electrons are also stored.
    codec : str
        Image format: ``png`` (16-bit), or ``jxl`` (lossless JPEG XL, 16-bit).
    """

    split: str = "train"
    shard_size: int = DEFAULT_SHARD_SIZE
    exr: bool = False
    codec: str = "png"

    def __post_init__(self) -> None:
        """Refuse invalid options. Raises GeneratorError."""
        if not self.split.isidentifier():
            raise GeneratorError(f"split '{self.split}': use letters, digits and _")
        if self.shard_size < 1:
            raise GeneratorError(f"shard size {self.shard_size}: at least 1")
        if self.codec not in CODECS:
            raise GeneratorError(f"codec '{self.codec}': one of {', '.join(CODECS)}")


@dataclass(frozen=True)
class Shard:
    """A run of frames that are stored together.

    Attributes
    ----------
    index : int
    first, stop : int
        Frames first to stop - 1.
    split : str
    """

    index: int
    first: int
    stop: int
    split: str

    @property
    def stem(self) -> str:
        """Name without suffix."""
        return f"shard-{self.index:06d}"

    @property
    def tar(self) -> str:
        """Path of the images and records, from the dataset's root."""
        return f"data/{self.split}/{self.stem}.tar"

    @property
    def frames(self) -> str:
        """Path of the table of frames."""
        return f"frames/{self.split}/{self.stem}.parquet"

    @property
    def stars(self) -> str:
        """Path of the table of stars."""
        return f"stars/{self.split}/{self.stem}.parquet"

    @property
    def objects(self) -> str:
        """Path of the table of flying objects and the Moon."""
        return f"objects/{self.split}/{self.stem}.parquet"

    @property
    def files(self) -> tuple[str, ...]:
        """Paths of the shard's files that the manifest lists."""
        return (self.tar, self.frames, self.stars, self.objects)

    @property
    def receipt(self) -> str:
        """Path of the receipt, written last: it marks the shard as complete."""
        return f"receipts/{self.split}/{self.stem}.json"

    @property
    def log(self) -> str:
        """Path of the log."""
        return f"logs/{self.split}/{self.stem}.log"


def imu_places(scenario: Scenario, split: str, first: int, stop: int) -> dict[int, str]:
    """Paths of the tables of inertial units that belong to frames first to stop - 1, by sequence."""
    if not scenario.has_imu:
        return {}
    return {sequence: f"{IMU}/{split}/sequence-{sequence:06d}.parquet" for sequence in scenario.sequences(first, stop)}


def natural_shard_size(frame_count: int) -> int:
    """Default number of frames per shard: small sets are divided so that many processes have work.

    It depends only on the number of frames, not on the machine, so everybody who runs or continues a scenario gets the
    same shards.
    """
    return min(DEFAULT_SHARD_SIZE, math.ceil(frame_count / SHARDS_OF_A_SMALL_SET))


def divide(scenario: Scenario, spec: DatasetSpec, first: int, stop: int) -> list[Shard]:
    """Divide frames first to stop - 1 into shards; shard boundaries do not depend on the range.

    Raises
    ------
    GeneratorError
        The range is empty or reaches beyond the scenario.
    """
    if not 0 <= first < stop <= scenario.frame_count:
        raise GeneratorError(
            f"frames {first}:{stop}: scenario '{scenario.name}' has frames 0:{scenario.frame_count}, stop excluded"
        )
    size = spec.shard_size
    return [
        Shard(index, max(first, index * size), min(stop, (index + 1) * size), spec.split)
        for index in range(first // size, (stop - 1) // size + 1)
    ]
