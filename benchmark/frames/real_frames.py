"""Frames of a task of photographs: imported once from the fetched files, then read."""

from __future__ import annotations

import dataclasses
import math
import shutil
from collections.abc import Callable
from pathlib import Path

from benchmark.errors import PhotographError, TaskError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import ALL, SUCCESS_METRIC, FrameFacts, FrameSet, Grading
from benchmark.frames.task_frames import UNPACKED, FrameChoice, split_folder
from benchmark.importing.drawn_centroids import draw_centroids
from benchmark.importing.told import read_told
from benchmark.importing.write import Import, import_photographs
from benchmark.real_tasks.definition import RealTask, RealTaskDefinition
from benchmark.real_tasks.fetch import missing_sources, sources_folder
from generator.frame.folder import STARS_FILE

DRAWN = "drawn"
"""Folder of the pictures of centroids, among the sources."""


def make_real_frames(
    task: RealTask, target: str, choice: FrameChoice, progress: Callable[[int], None] = lambda frames: None
) -> FrameSet:
    """Import a task's photographs where this has not been done, and read them.

    Parameters
    ----------
    task : RealTask
    target : str
        Name that the user gave.
    choice : FrameChoice
        Only `condition` and `data` are used; a task of photographs has one split and uses all of its frames.
    progress : callable
        Called with the number of frames that have become available.

    Raises
    ------
    TaskError
        The photographs have not been fetched, or there is no such condition; the message says what to do.
    """
    definition, graded = task.definition, task.definition.condition
    if choice.per_condition is not None:
        raise TaskError(
            f"{task.label}: has {len(definition.conditions)} photographs, all of which count; leave out --frames"
        )
    if choice.condition is not None and not any(math.isclose(value, choice.condition) for value in graded.values):
        values = ", ".join(f"{value:g}" for value in graded.values)
        raise TaskError(f"{task.label}: {graded.name} {choice.condition:g} is not one of its values: {values}")
    if missing := missing_sources(task, choice.data):
        name = definition.name
        raise TaskError(
            f"{task.label}: {len(missing)} of {len(definition.sources)} photographs are not in "
            f"{sources_folder(task, choice.data)} ({missing[0].file}, …); run: skybench fetch {name}"
        )
    folder = split_folder(task.label, ALL, task.sha256, choice.data)
    place = sources_folder(task, choice.data)
    try:
        files = _drawn(definition, place) if definition.drawn else [place / each.file for each in definition.sources]
        told = read_told(task.camera_file)
        if definition.attitude == "night":
            told = told.for_another_night()
        import_photographs(
            Import(definition.name, files, task.place, told), folder / UNPACKED, True, lambda made: progress(1)
        )
    except PhotographError as error:
        raise TaskError(f"{task.label}: {error}") from error
    # The folder in which the report looks for the stars of a task.
    stars = folder / "stars" / ALL / STARS_FILE
    stars.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(folder / UNPACKED / STARS_FILE, stars)
    dataset = open_dataset(folder / UNPACKED)
    frames = tuple(
        dataclasses.replace(frame, condition=condition)
        for frame, condition in zip(dataset.frames, definition.conditions, strict=True)
        if choice.condition is None or math.isclose(condition, choice.condition)
    )
    facts = FrameFacts(
        target=target,
        label=task.label,
        title=definition.title,
        split=ALL,
        condition=None if choice.condition is None else frames[0].condition,
        per_condition=None,
        grading=Grading(graded.name, graded.unit, graded.values, graded.harder),
        metric=SUCCESS_METRIC,
        definition_sha256=task.sha256,
        scenario_name=dataset.scenario_name,
        scenario_sha256=task.sha256,
        truth_sha256=dataset.truth_sha256,
        rendered_with=dataset.provenance,
    )
    return FrameSet(facts, frames)


def _drawn(definition: RealTaskDefinition, place: Path) -> list[Path]:
    """Draw the centroids of a task's frames, night by night; returns the pictures in the order of the definition."""
    pictures: dict[str, Path] = {}
    for source in definition.sources:
        names = [each.frame for each in definition.drawn if each.night == source.file]
        pictures |= dict(zip(names, draw_centroids(place / source.file, place / DRAWN, names), strict=True))
    return [pictures[each.frame] for each in definition.drawn]
