"""Frames of a task: rendered where they are missing, and read with what solvers are told about them."""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmark.errors import TaskError
from benchmark.frames.dataset import Frame, read_frames, rendered_with, truth_digest
from benchmark.frames.frame_set import FrameFacts, FrameSet, Grading
from benchmark.frames.record_values import read_record
from benchmark.frames.sites import with_sites
from benchmark.frames.task_shards import (
    SHARD_FRAMES,
    ChosenShard,
    StoredShard,
    by_home,
    chosen_shards,
    find_stored,
)
from benchmark.instruments import told
from benchmark.protocol import SequencePlace
from benchmark.tasks.definition import SplitName, Task
from generator.dataset.archive import read_frames as read_archive
from generator.dataset.images import photo
from generator.dataset.layout import DatasetSpec
from generator.dataset.run import open_dataset_target, run_shards
from generator.dataset.target import LocalTarget
from generator.errors import GeneratorError
from generator.files import path_within, write_bytes
from generator.seeds import random_stream

UNPACKED = "unpacked"
DEFAULT_DATA = Path("out/tasks")
"""Folder of the frames of tasks and sharded datasets."""


@dataclass(frozen=True)
class FrameChoice:
    """Choice of a task's frames, and the folder in which frames are kept.

    Attributes
    ----------
    split : str
    per_condition : int or None
        Number of frames at each value of the condition, at most the task's own number, which is the meaning of None. A larger
        choice begins with the same frames as a smaller one.
    condition : float or None
        Only the frames of this value, as the task states it; None for all values.
    data : Path
        Folder of all frames; each split of a task and each sharded dataset has its own folder within it.
    workers : int
        Number of processes that render; with 0, this process renders.
    """

    split: SplitName = "dev"
    per_condition: int | None = None
    condition: float | None = None
    data: Path = DEFAULT_DATA
    workers: int = 1


def make_task_frames(
    task: Task, target: str, choice: FrameChoice, progress: Callable[[int], None] = lambda frames: None
) -> FrameSet:
    """Render the missing frames of a task, and read all of them.

    Parameters
    ----------
    task : Task
    target : str
        What the user gave: the task's name or the path of its file.
    choice : FrameChoice
    progress : callable
        Called with the number of frames that have become available.

    Returns
    -------
    FrameSet
        With unique ids, with `condition` set, and with observations as the solver receives them.

    Raises
    ------
    TaskError
        There is no such condition, a frame cannot be rendered, or the folder cannot be used.
    """
    split, definition = choice.split, task.definition
    per_condition, levels = frames_per_condition(task, choice), chosen_levels(task, choice.condition)
    scenario = task.scenario_of(split)
    folder = split_folder(task.label, split, scenario.sha256, choice.data)
    shards = _chosen_shards(task, choice)
    unpacked, developed = folder / UNPACKED, definition.image == "photo"
    stored: list[StoredShard] = []
    missing: list[ChosenShard] = []
    try:
        spec = DatasetSpec(split=split, shard_size=SHARD_FRAMES)
        open_dataset_target(LocalTarget(folder), scenario, task.text_of(split))
        for one in shards:
            found = find_stored(folder, one, scenario, spec)
            if found is None:
                missing.append(one)
                continue
            stored.append(found)
            if not _is_unpacked(one.frame_ids, unpacked):
                _unpack(found.archive, unpacked, developed, one.frame_ids)
            progress(len(one.frame_ids))
        for home, rendered in by_home(folder, missing).items():
            for report in run_shards(
                scenario, spec, rendered, LocalTarget(home), choice.workers, lambda index: progress(1)
            ):
                if report.failures:
                    raise TaskError(f"{task.label}: frame {report.failures[0].index}: {report.failures[0].error}")
                stored.append(StoredShard(home, report.shard))
                _unpack(stored[-1].archive, unpacked, developed)
    except GeneratorError as error:
        raise TaskError(f"{task.label}: {error}") from error
    records = [unpacked / f"{frame_id}.json" for one in shards for frame_id in one.frame_ids]
    read = with_sites(read_frames(records, [one.stars for one in stored]))
    frames = tuple(_graded(task, split, read))
    graded = definition.condition
    facts = FrameFacts(
        target=target,
        label=task.label,
        title=definition.title,
        split=split,
        condition=None if choice.condition is None else graded.values[levels[0]],
        per_condition=per_condition,
        grading=Grading(graded.name, graded.unit, graded.values, graded.harder),
        metric=task.metric_key,
        definition_sha256=task.sha256,
        scenario_name=scenario.name,
        scenario_sha256=scenario.sha256,
        truth_sha256=truth_digest(frames),
        rendered_with=rendered_with(read_record(records[0])),
    )
    return FrameSet(facts, frames)


def at_hand(task: Task, choice: FrameChoice) -> bool:
    """Whether all frames of a choice have been rendered. Raises TaskError where the folder holds other frames."""
    scenario, spec = task.scenario_of(choice.split), DatasetSpec(split=choice.split, shard_size=SHARD_FRAMES)
    folder = split_folder(task.label, choice.split, scenario.sha256, choice.data)
    try:
        return all(find_stored(folder, one, scenario, spec) is not None for one in _chosen_shards(task, choice))
    except GeneratorError as error:
        raise TaskError(f"{task.label}: {error}") from error


def _chosen_shards(task: Task, choice: FrameChoice) -> list[ChosenShard]:
    levels, length = chosen_levels(task, choice.condition), task.sequence_length
    if length > 1:
        if choice.condition is not None:
            raise TaskError(f"{task.label}: the frames of a sequence are asked in order; leave out the condition")
        levels = [0]  # one block: the first sequences hold the first frames of all conditions
    full, chosen = task.definition.frames_per_condition * length, frames_per_condition(task, choice) * length
    return chosen_shards(full, chosen, choice.split, levels)


def frames_per_condition(task: Task, choice: FrameChoice) -> int:
    """Number of frames chosen at each value of the condition. Raises TaskError where the task has fewer."""
    full = task.definition.frames_per_condition
    chosen = full if choice.per_condition is None else choice.per_condition
    if not 1 <= chosen <= full:
        raise TaskError(f"{task.label}: {chosen} frames a condition; it has 1 to {full}")
    return chosen


def chosen_levels(task: Task, condition: float | None) -> list[int]:
    """Indices of the chosen values among the task's, from easy to hard.

    Raises
    ------
    TaskError
        The task has no such value; the message lists those that it has.
    """
    graded = task.definition.condition
    if condition is None:
        return list(range(len(graded.values)))
    found = [level for level, value in enumerate(graded.values) if math.isclose(value, condition)]
    if not found:
        values = ", ".join(f"{value:.12g}" for value in graded.values)
        raise TaskError(f"{task.label}: {graded.name} {condition:.12g} is not one of its values: {values}")
    return found


def split_folder(label: str, split: str, scenario_sha256: str, data: Path) -> Path:
    """Folder of the frames of a task's split."""
    return data / label / f"{split}-{scenario_sha256[:12]}"


def _is_unpacked(frame_ids: Collection[str], folder: Path) -> bool:
    """Whether the images and records of all these frames are in the folder; each was written atomically."""
    return all((folder / f"{frame_id}.{suffix}").is_file() for frame_id in frame_ids for suffix in ("png", "json"))


def _unpack(archive_path: Path, folder: Path, developed: bool, missing: Collection[str] | None = None) -> None:
    """Unpack a shard's images and records into one folder, where programs can read them.

    With `missing`, only those of these frames that are not there yet; without it all, in place of any that are there. For
    `developed` frames the image is the photograph's luma, 0 to 255, instead of the raw image.
    """
    try:
        for frame in read_archive(archive_path):
            if missing is not None and frame.frame_id not in missing:
                continue
            for suffix in ("png", "json"):
                path = path_within(folder, f"{frame.frame_id}.{suffix}")
                if missing is None or not path.is_file():
                    as_photo = developed and suffix == "png"
                    write_bytes(path, _luma_png(frame.members["photo.jpg"]) if as_photo else frame.members[suffix])
    except KeyError as error:
        raise TaskError(
            f"{archive_path}: {frame.frame_id} has no {error}; delete it and run the same command again"
        ) from error
    except (GeneratorError, OSError) as error:
        raise TaskError(f"{error}; delete {archive_path} and run the same command again") from error


def _luma_png(jpeg: bytes) -> bytes:
    """Convert a photograph to its luma (ITU-R BT.601, as in JPEG) as a 16-bit PNG of one channel."""
    luma = np.asarray(Image.fromarray(photo(jpeg)).convert("L"), dtype=np.uint16)
    buffer = io.BytesIO()
    Image.fromarray(luma).save(buffer, format="PNG")
    return buffer.getvalue()


def _graded(task: Task, split: SplitName, frames: Sequence[Frame]) -> list[Frame]:
    """Give every frame its condition, and each observation the instruments' readings for the solver at that condition."""
    length = task.sequence_length
    if length > 1:
        return [_in_sequence(task, split, frame, length) for frame in frames]
    definition, seed = task.definition, task.definition.splits[split].seed
    found = []
    for frame in frames:
        level = frame.index // definition.frames_per_condition
        rng = random_stream(seed, "task:instruments", frame.index)
        seen = told(frame.observation, definition.instruments.at(level), rng)
        found.append(dataclasses.replace(frame, condition=definition.condition.values[level], observation=seen))
    return found


def _in_sequence(task: Task, split: SplitName, frame: Frame, length: int) -> Frame:
    """Give a frame of a sequence its condition, which is the number of frames so far."""
    seed, precision = task.definition.splits[split].seed, task.definition.instruments.at(0)
    number, index = divmod(frame.index, length)
    own = random_stream(seed, "task:instruments", frame.index)
    seen = told(frame.observation, precision, own, random_stream(seed, "task:sequence", number))
    place = SequencePlace(f"sequence-{number:05d}", index, length, precision.tilt_bias_sigma_deg)
    return dataclasses.replace(frame, condition=index + 1.0, observation=dataclasses.replace(seen, sequence=place))
