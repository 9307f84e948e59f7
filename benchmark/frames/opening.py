"""Opening frames, however a user names them: a task, a task's file, a rendered folder, a sharded dataset."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmark.errors import DatasetError, TaskError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import FrameSet, ungraded
from benchmark.frames.real_frames import make_real_frames
from benchmark.frames.sharded import open_sharded
from benchmark.frames.task_frames import FrameChoice, make_task_frames
from benchmark.real_tasks.definition import is_real_task, load_real_task, real_task_names
from benchmark.tasks.definition import TASK_SUFFIX, Task, load_task, load_task_file, task_names
from generator.dataset.layout import MANIFEST

_NO_CHOICE = FrameChoice()


def named_task(target: str) -> Task | None:
    """Find the task that a target names, by its name or its file; None where it names something else.

    Raises
    ------
    TaskError
        Its files are invalid.
    """
    if target.endswith(TASK_SUFFIX):
        return load_task_file(Path(target))
    if "/" in target or target.partition("@")[0] not in task_names():
        return None
    return load_task(target)


def open_frames(
    target: str, choice: FrameChoice = _NO_CHOICE, progress: Callable[[int], None] = lambda frames: None
) -> FrameSet:
    """Open the frames that a target names; missing frames of a task are rendered.

    Parameters
    ----------
    target : str
        Task (``bortle``, ``bortle@2``, ``allsky-real``), file of a task (``NAME.task.yaml``), folder written by
        `skybench render` or `skybench import`, folder or URL written by `skybench generate`.
    choice : FrameChoice
        Split, number and condition, which apply only to the frames of a task.
    progress : callable
        Called with the number of frames that have become available.

    Raises
    ------
    DatasetError, TaskError
        There are no such frames, or they cannot be used; the message says why and what to do.
    """
    task = named_task(target)
    if task is not None:
        return make_task_frames(task, target, choice, progress)
    if is_real_task(target):
        return make_real_frames(load_real_task(target), target, choice, progress)
    if (choice.condition is not None or choice.per_condition is not None) and (
        "://" in target or Path(target).is_dir()
    ):
        raise TaskError(f"{target}: is not a task, so nothing grades its frames; leave out --condition and --frames")
    if "://" in target or (Path(target) / MANIFEST).is_file():
        return open_sharded(target, choice.data, progress)
    folder = Path(target)
    if not folder.is_dir():
        known = ", ".join((*task_names(), *real_task_names()))
        raise DatasetError(
            f"{target}: no such folder, and not a task ({known}); render frames with "
            f"`skybench render SCENARIO --out {target}`"
        )
    found = ungraded(open_dataset(folder), target)
    missing = [frame.image_path for frame in found.frames if not frame.image_path.is_file()]
    if missing:
        raise DatasetError(f"{missing[0]}: missing image; render the dataset again with `skybench render`")
    progress(len(found.frames))
    return found
