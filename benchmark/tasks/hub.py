"""Task of a dataset's frames, and ``eval.yaml``, in which the Hugging Face Hub expects the description of a benchmark.

Specification: https://huggingface.co/docs/hub/eval-results. The Hub keeps a list of evaluation frameworks; ``skybench`` has
to be added to it (packages/tasks/src/eval.ts of huggingface.js) before the Hub accepts the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from benchmark.errors import TaskError
from benchmark.tasks.card import card, limits
from benchmark.tasks.definition import LARGEST_FILE_BYTES, SPLITS, SplitName, Task, load_task, task_names
from benchmark.yaml_file import read_yaml
from generator.dataset.manifest import Manifest
from generator.export.huggingface import EVAL, TASK_CARD_PREFIX
from generator.files import write_bytes

FRAMEWORK = "skybench"


@dataclass(frozen=True)
class TaskSplit:
    """A task and one of its splits."""

    task: Task
    split: SplitName


def task_of(manifest: Manifest) -> TaskSplit | None:
    """Find the task whose frames a dataset contains in full; None where they belong to no task of this version."""
    for name in task_names():
        task = load_task(name)
        for split in SPLITS:
            scenario = task.scenario_of(split)
            whole = (manifest.first, manifest.stop) == (0, scenario.frame_count)
            if manifest.scenario_sha256 == scenario.sha256 and whole:
                return TaskSplit(task, split)
    return None


def write_eval(folder: Path, found: TaskSplit, hub_split: str) -> None:
    """Add a task to ``eval.yaml`` of a repository, next to the tasks that it lists, and write the task's card.

    Parameters
    ----------
    folder : Path
    found : TaskSplit
    hub_split : str
        Name of the split in the repository.

    Raises
    ------
    TaskError
        There is an ``eval.yaml`` that cannot be read.
    """
    definition = found.task.definition
    identity = f"{definition.name}-{definition.revision}-{found.split}"
    others = [entry for entry in _entries(folder / EVAL) if entry.get("id") != identity]
    entry = {"id": identity, "config": "frames", "split": hub_split}
    content = {
        "name": f"skybench {found.task.label}",
        "description": f"{definition.title}. Share of frames whose position is found within {found.task.limit_km:.4g} km.",
        "evaluation_framework": FRAMEWORK,
        "tasks": sorted([*others, entry], key=lambda each: str(each["id"])),
    }
    write_bytes(folder / f"{TASK_CARD_PREFIX}{definition.name}.md", f"{card(found.task)}\n{limits()}".encode())
    write_bytes(folder / EVAL, yaml.safe_dump(content, sort_keys=False, allow_unicode=True).encode())


def _entries(path: Path) -> list[dict[str, Any]]:
    """Read the tasks listed in an existing file. Raises TaskError if it cannot be read, since it would be replaced."""
    if not path.exists():
        return []
    found = read_yaml(path, LARGEST_FILE_BYTES, TaskError).get("tasks")
    if not isinstance(found, list):
        raise TaskError(f"{path}: tasks: expected a list; mend it, or move the file away")
    return [entry for entry in found if isinstance(entry, dict) and isinstance(entry.get("id"), str)]
