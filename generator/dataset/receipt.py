"""Receipts: lists of a shard's complete files, and checks of the files against them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.target import LocalTarget, Target
from generator.errors import GeneratorError
from generator.files import write_bytes
from generator.reading.json_text import strict_json
from generator.scenario.file import Scenario
from generator.stored_files import StoredFile, listed_files, stored_file

FORMAT = "skybench-receipt/1"
LARGEST_RECEIPT_BYTES = 1_000_000
"""Limit of the size of a receipt, which lists four files."""


def write_receipt(
    folder: Path, shard: Shard, scenario: Scenario, spec: DatasetSpec, files: tuple[StoredFile, ...]
) -> None:
    """Write a shard's receipt atomically; it is written last, because it marks the shard as complete."""
    receipt = {
        "format": FORMAT,
        "scenario_sha256": scenario.sha256,
        "codec": spec.codec,
        "exr": spec.exr,
        "first": shard.first,
        "stop": shard.stop,
        "files": [asdict(file) for file in files],
    }
    write_bytes(folder / shard.receipt, json.dumps(receipt, indent=1).encode())


def read_receipt(target: Target, shard: Shard, scenario: Scenario, spec: DatasetSpec) -> tuple[StoredFile, ...] | None:
    """Return a shard's files from its receipt, or None if there is no intact receipt of these frames.

    Raises
    ------
    GeneratorError
        The receipt belongs to another scenario, or to other options.
    """
    try:
        receipt = strict_json(target.read(shard.receipt) or b"", shard.receipt, LARGEST_RECEIPT_BYTES)
        files = listed_files(receipt["files"])
        same_frames = (receipt["first"], receipt["stop"]) == (shard.first, shard.stop)
        same_scenario = receipt["scenario_sha256"] == scenario.sha256
        same_spec = (receipt["codec"], receipt["exr"]) == (spec.codec, spec.exr)
    except (GeneratorError, ValueError, KeyError, TypeError, AttributeError):
        return None
    if not same_scenario:
        raise GeneratorError(f"{target.name}/{shard.receipt}: belongs to another scenario; choose another folder")
    if not same_spec:
        raise GeneratorError(
            f"{target.name}/{shard.receipt}: was made with another --codec or --exr; choose another folder"
        )
    return files if same_frames and {file.path for file in files} == set(shard.files) else None


def finished_files(
    target: Target,
    shard: Shard,
    scenario: Scenario,
    spec: DatasetSpec,
    size_of: Callable[[str], int | None] | None = None,
) -> tuple[StoredFile, ...] | None:
    """Return the files of a complete shard with the sizes in its receipt, otherwise None. Raises as `read_receipt`.

    `size_of` supplies sizes that are already known, by place; without it the target is queried.
    """
    size_of = size_of or target.size
    files = read_receipt(target, shard, scenario, spec)
    return files if files is not None and all(size_of(file.path) == file.bytes for file in files) else None


def damaged_files(target: Target, files: tuple[StoredFile, ...]) -> tuple[str, ...]:
    """Paths of files that are missing or have changed: compared by hash in a folder, by size in an object store."""
    return tuple(file.path for file in files if not _intact(target, file))


def _intact(target: Target, file: StoredFile) -> bool:
    if target.size(file.path) != file.bytes:
        return False
    return not isinstance(target, LocalTarget) or stored_file(target.folder, file.path) == file
