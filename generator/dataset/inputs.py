"""Files that a scenario names (meshes, horizons, logs, …), copied into the dataset to make it reproducible."""

from __future__ import annotations

import hashlib
import re
import shutil
import tempfile
from pathlib import Path

from generator.dataset.layout import CARD, CROISSANT, FIGURES, IMU, MANIFEST, SCENARIO_COPY, TABLES
from generator.dataset.target import Target
from generator.errors import GeneratorError
from generator.scenario.file import Scenario
from generator.scenario.strict import InputFile
from generator.stored_files import StoredFile

OWN_NAMES = (*TABLES, IMU, "data", "receipts", "logs", FIGURES, CARD, CROISSANT, MANIFEST, SCENARIO_COPY)
"""Names at a dataset's root, which a scenario's own files may not have."""
_SAFE_PART = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*")


def store_inputs(target: Target, scenario: Scenario, ours: bool) -> list[str]:
    """Copy the scenario's files next to the dataset's copy of the scenario; existing copies are checked.

    Parameters
    ----------
    target : Target
    scenario : Scenario
    ours : bool
        Whether the existing dataset is known to be this scenario's: a copy that differs is then damaged, and is replaced.

    Returns
    -------
    list of str
        Copies that were damaged.

    Raises
    ------
    GeneratorError
        A name cannot be kept, a file has changed since the scenario was read, or the dataset contains a different one.
    """
    damaged = []
    for file in scenario.files:
        check_name(file.path)
        stored = target.read(file.path)
        intact = stored is not None and hashlib.sha256(stored).hexdigest() == file.sha256
        if intact:
            continue
        if ours:
            damaged.append(file.path)
        elif stored is not None:
            raise GeneratorError(
                f"{target.name}/{file.path}: differs from the file of this name beside the scenario; choose another folder"
            )
        with tempfile.TemporaryDirectory(prefix="skybench-") as scratch:
            local = Path(scratch) / "input"
            shutil.copyfile(file.location, local)
            if hashlib.sha256(local.read_bytes()).hexdigest() != file.sha256:
                raise GeneratorError(f"{file.location}: changed since the scenario was read; run the command again")
            target.put(local, file.path)
    return damaged


def check_name(path: str) -> None:
    """Refuse a path that is not portable, or that is one of the dataset's own. Raises GeneratorError."""
    parts = path.split("/")
    if not all(_SAFE_PART.fullmatch(part) for part in parts):
        raise GeneratorError(
            f"the scenario's file '{path}' is copied into the dataset: use letters, digits, _, - and . in its name, "
            "and / between folders"
        )
    if parts[0] in OWN_NAMES:
        raise GeneratorError(
            f"the scenario's file '{path}' would lie where the dataset keeps its own '{parts[0]}'; rename it"
        )


def stored_inputs(target: Target, scenario: Scenario) -> list[StoredFile]:
    """Return the copies in the form in which the manifest lists them."""
    return [_measured(target, file) for file in scenario.files]


def _measured(target: Target, file: InputFile) -> StoredFile:
    size = target.size(file.path)
    if size is None:
        raise GeneratorError(f"{target.name}/{file.path}: missing; run the same command again")
    return StoredFile(file.path, size, file.sha256)
