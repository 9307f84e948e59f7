"""Where a task's frames are stored: whole shards in the folder of its split, the beginnings of shards apart from them.

A choice of few frames ends within shards. Its frames are rendered into a folder that is only for beginnings of that length,
so no run replaces a shard by a smaller one, even while another run reads or writes the larger.
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.tasks.definition import SplitName
from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.receipt import finished_files
from generator.dataset.target import LocalTarget
from generator.scenario.file import Scenario

SHARD_FRAMES = 10
BEGINNINGS = "beginnings"


@dataclass(frozen=True)
class ChosenShard:
    """The frames of one shard that a choice contains, from the first on.

    Attributes
    ----------
    chosen : Shard
        Only the frames of the choice.
    whole : Shard
        All frames that the task has in this shard.
    """

    chosen: Shard
    whole: Shard

    @property
    def frame_ids(self) -> list[str]:
        """Ids of the chosen frames."""
        return [f"frame-{index:05d}" for index in range(self.chosen.first, self.chosen.stop)]

    def home(self, folder: Path) -> Path:
        """Folder into which the chosen frames are rendered, within that of the task's split."""
        return folder if self.chosen == self.whole else _home_of(folder, self.chosen)


@dataclass(frozen=True)
class StoredShard:
    """A shard on disk, with the chosen frames and perhaps more."""

    folder: Path
    shard: Shard

    @property
    def archive(self) -> Path:
        """Its images and records."""
        return self.folder / self.shard.tar

    @property
    def stars(self) -> Path:
        """Its table of stars."""
        return self.folder / self.shard.stars


def find_stored(folder: Path, one: ChosenShard, scenario: Scenario, spec: DatasetSpec) -> StoredShard | None:
    """Find a complete shard on disk that begins with the chosen frames, the one with the most frames first.

    Raises
    ------
    GeneratorError
        The folder holds frames of another scenario.
    """
    for stop in range(one.whole.stop, one.chosen.stop - 1, -1):
        shard = dataclasses.replace(one.whole, stop=stop)
        for home in (folder, _home_of(folder, shard)):
            if finished_files(LocalTarget(home), shard, scenario, spec) is not None:
                return StoredShard(home, shard)
    return None


def by_home(folder: Path, missing: Iterable[ChosenShard]) -> dict[Path, list[Shard]]:
    """Shards to be rendered, by the folder into which they are rendered."""
    homes: defaultdict[Path, list[Shard]] = defaultdict(list)
    for one in missing:
        homes[one.home(folder)].append(one.chosen)
    return dict(homes)


def star_folders(folder: Path, split: str) -> tuple[Path, ...]:
    """Folders with tables of stars under the folder of a task's split; a frame may be in tables of several."""
    return folder / "stars" / split, *sorted((folder / BEGINNINGS).glob(f"*/stars/{split}"))


def chosen_shards(
    frames_of_each: int, per_condition: int, split: SplitName, levels: Sequence[int]
) -> list[ChosenShard]:
    """Shards that contain the first `per_condition` frames of conditions with `frames_of_each` frames each."""
    shards_per_condition = math.ceil(frames_of_each / SHARD_FRAMES)
    found = []
    for level in levels:
        start = level * frames_of_each
        for number, offset in enumerate(range(0, per_condition, SHARD_FRAMES)):
            whole, chosen = (
                Shard(
                    level * shards_per_condition + number,
                    start + offset,
                    start + min(offset + SHARD_FRAMES, count),
                    split,
                )
                for count in (frames_of_each, per_condition)
            )
            found.append(ChosenShard(chosen, whole))
    return found


def _home_of(folder: Path, shard: Shard) -> Path:
    return folder / BEGINNINGS / f"{shard.stop - shard.first:02d}"
