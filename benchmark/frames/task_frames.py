"""The frames of a task: rendered where they are missing, and read with what a solver is told about them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmark.errors import TaskError
from benchmark.frames.dataset import Frame, read_frames
from benchmark.protocol import Observation
from benchmark.tasks.definition import SplitName, Task, Told
from generator.dataset.archive import read_frames as read_archive
from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.run import open_dataset_target, run_shards
from generator.dataset.shard import read_receipt
from generator.dataset.target import LocalTarget
from generator.errors import GeneratorError
from generator.files import path_within, write_bytes
from generator.scenario.file import Scenario
from generator.seeds import random_stream

SHARD_FRAMES = 10
UNPACKED = "unpacked"
UNKNOWN_HEADING_DEG = 180.0


@dataclass(frozen=True)
class TaskFrames:
    """Frames of one split, condition by condition.

    Attributes
    ----------
    task : Task
    split : str
    per_condition : int
    scenario_sha256 : str
        Of the split's scenario, the generator's version included.
    frames : tuple of Frame
        With unique ids, `condition` set, and observations as the solver is told them.
    """

    task: Task
    split: SplitName
    per_condition: int
    scenario_sha256: str
    frames: tuple[Frame, ...]


def make_task_frames(
    task: Task,
    split: SplitName,
    per_condition: int,
    data: Path,
    workers: int,
    progress: Callable[[int], None] = lambda frames: None,
) -> TaskFrames:
    """Render what is missing of a split, and read it.

    The first `per_condition` frames of a condition are the same however many are asked for.

    Parameters
    ----------
    task : Task
    split : str
    per_condition : int
        At most the task's own number.
    data : Path
        Folder of all tasks' frames; each split has one of its own in it, named after task, split and scenario hash.
    workers : int
        Processes that render; 0 renders in this one.
    progress : callable
        Called with the number of frames that have come to hand.

    Raises
    ------
    TaskError
        A frame cannot be made, or the folder cannot be used.
    """
    full = task.definition.frames_per_condition
    if not 1 <= per_condition <= full:
        raise TaskError(f"{task.label}: {per_condition} frames a condition; it has 1 to {full}")
    scenario = task.scenario_of(split)
    folder = split_folder(task, split, scenario, data)
    shards = wanted_shards(scenario, per_condition, split)
    unpacked = folder / UNPACKED
    try:
        spec = DatasetSpec(split=split, shard_size=SHARD_FRAMES)
        target = LocalTarget(folder)
        open_dataset_target(target, scenario, task.text_of(split))
        missing = [shard for shard in shards if read_receipt(target, shard, scenario, spec) is None]
        for shard in shards:
            if shard not in missing:
                _unpack(folder / shard.tar, unpacked, again=False)
                progress(shard.stop - shard.first)
        for report in run_shards(scenario, spec, missing, target, workers, lambda index: progress(1)):
            if report.failures:
                raise TaskError(f"{task.label}: frame {report.failures[0].index}: {report.failures[0].error}")
            _unpack(folder / report.shard.tar, unpacked, again=True)
    except GeneratorError as error:
        raise TaskError(f"{task.label}: {error}") from error
    records = [unpacked / f"frame-{index:05d}.json" for shard in shards for index in range(shard.first, shard.stop)]
    frames = read_frames(records, [folder / shard.stars for shard in shards])
    return TaskFrames(task, split, per_condition, scenario.sha256, tuple(_graded(task, split, list(frames))))


def split_folder(task: Task, split: SplitName, scenario: Scenario, data: Path) -> Path:
    """Folder of a split's frames."""
    return data / task.label / f"{split}-{scenario.sha256[:12]}"


def wanted_shards(scenario: Scenario, per_condition: int, split: SplitName) -> list[Shard]:
    """Shards that hold the first frames of every combination of the scenario."""
    shards_per_condition = math.ceil(scenario.repeats / SHARD_FRAMES)
    shards = []
    for combination in range(scenario.combination_count):
        start = combination * scenario.repeats
        for number, offset in enumerate(range(0, per_condition, SHARD_FRAMES)):
            stop = start + min(offset + SHARD_FRAMES, per_condition)
            shards.append(Shard(combination * shards_per_condition + number, start + offset, stop, split))
    return shards


def _unpack(archive_path: Path, folder: Path, again: bool) -> None:
    """Put a shard's images and records beside each other, where programs can read them."""
    try:
        for frame in read_archive(archive_path):
            for suffix in ("png", "json"):
                path = path_within(folder, f"{frame.frame_id}.{suffix}")
                if again or not path.is_file():
                    write_bytes(path, frame.members[suffix])
    except KeyError as error:
        raise TaskError(
            f"{archive_path}: {frame.frame_id} has no {error}; delete it and run the same command again"
        ) from error
    except (GeneratorError, OSError) as error:
        raise TaskError(f"{error}; delete {archive_path} and run the same command again") from error


def _graded(task: Task, split: SplitName, frames: list[Frame]) -> list[Frame]:
    """Give every frame its condition, and each observation what the solver is told."""
    values = task.definition.condition.values
    told = task.definition.told
    if not told.lengths:
        repeats = task.definition.frames_per_condition
        return [dataclasses.replace(frame, condition=values[frame.index // repeats]) for frame in frames]
    seed = task.definition.splits[split].seed
    return [
        dataclasses.replace(
            frame,
            frame_id=f"{frame.frame_id}-{level}",
            index=level * task.definition.frames_per_condition + frame.index,
            condition=value,
            observation=misinformed(frame.observation, told, level, seed, frame.index),
        )
        for level, value in enumerate(values)
        for frame in frames
    ]


def misinformed(seen: Observation, told: Told, level: int, seed: int, index: int) -> Observation:
    """What a solver is told of a frame at a level of difficulty.

    The vertical is tilted about a horizontal axis, and the heading turned about the vertical, by Gaussian angles of the
    level's standard deviations; the focal length is multiplied by 1 plus or minus the level's error.

    Parameters
    ----------
    seen : Observation
        The truth.
    told : Told
    level : int
    seed : int
        The split's root.
    index : int
        Of the rendered frame.
    """
    tilt = told.tilt_sigma_deg[level] if told.tilt_sigma_deg else 0.0
    heading = told.heading_sigma_deg[level] if told.heading_sigma_deg else 0.0
    focal = told.focal_error[level] if told.focal_error else 0.0
    unknown = heading >= UNKNOWN_HEADING_DEG
    rng = random_stream(seed, f"task:told:{level}", index)
    east, north = rng.normal(0.0, tilt, 2)
    turn = rng.uniform(-180.0, 180.0) if unknown else rng.normal(0.0, heading)
    sign = 1.0 if rng.uniform() < 0.5 else -1.0
    wrong = Rotation.from_rotvec([east, north, 0.0], degrees=True) * Rotation.from_rotvec(
        [0.0, 0.0, turn], degrees=True
    )
    R_cam: NDArray[np.float64] = seen.R_cam @ wrong.as_matrix()
    camera = dataclasses.replace(
        seen.camera, f_px=seen.camera.f_px * (1.0 + sign * focal), fy_px=seen.camera.fy_px * (1.0 + sign * focal)
    )
    return dataclasses.replace(
        seen,
        camera=camera,
        R_cam=R_cam,
        tilt_sigma_deg=tilt,
        heading_sigma_deg=math.inf if unknown else heading,
    )
