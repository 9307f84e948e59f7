"""Superseded results: those of an earlier revision of a task next to a later one, and those of retired tasks."""

from __future__ import annotations

import shutil
from collections import defaultdict
from pathlib import Path

from benchmark.tasks.definition import RETIRED


def superseded(root: Path) -> dict[Path, str]:
    """Folders of results that have a later revision of their task next to them, and why they do not count.

    Revisions differ in meaning: a mean over both would count one question twice.
    """
    found: defaultdict[str, dict[int, Path]] = defaultdict(dict)
    for folder in sorted(root.glob("*@*")):
        name, _, revision = folder.name.rpartition("@")
        if revision.isdecimal() and folder.is_dir() and any(folder.iterdir()):
            found[name][int(revision)] = folder
    return {
        folder: f"{name}@{max(revisions)} is there"
        for name, revisions in sorted(found.items())
        for revision, folder in revisions.items()
        if revision < max(revisions)
    }


def outdated(root: Path) -> dict[Path, str]:
    """The `superseded` folders and those of retired tasks, and why."""
    retired = {folder: "the task is retired" for name in sorted(RETIRED) for folder in sorted(root.glob(f"{name}@*/"))}
    return superseded(root) | retired


def remove_outdated(root: Path) -> dict[Path, str]:
    """Remove the `outdated` folders of a tree of results; returns them with the reasons."""
    found = outdated(root)
    for folder in found:
        shutil.rmtree(folder)
    return found
