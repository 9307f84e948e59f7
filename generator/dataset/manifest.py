"""The manifest: the list of a dataset's files, written when all others are complete."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from generator import __version__
from generator.dataset.layout import MANIFEST, DatasetSpec
from generator.dataset.target import Target
from generator.errors import GeneratorError
from generator.files import path_within, write_bytes
from generator.reading.json_text import strict_json
from generator.scenario.file import Scenario
from generator.stored_files import (
    LARGEST_MANIFEST_BYTES,
    StoredFile,
    count_under,
    listed_files,
    manifest_bytes,
    text_under,
)

FORMAT = "skybench-dataset/1"


@dataclass(frozen=True)
class Manifest:
    """Contents of manifest.json.

    Attributes
    ----------
    scenario, scenario_sha256 : str
    seed : int
    skybench : str
        Version of skybench that wrote the dataset.
    split, codec : str
    shard_size : int
    exr : bool
    first, stop : int
        Frames first to stop - 1 of the scenario.
    files : tuple of StoredFile
        Every file except the manifest, logs and receipts, sorted by path.
    """

    scenario: str
    scenario_sha256: str
    seed: int
    skybench: str
    split: str
    codec: str
    shard_size: int
    exr: bool
    first: int
    stop: int
    files: tuple[StoredFile, ...]


def make_manifest(scenario: Scenario, spec: DatasetSpec, first: int, stop: int, files: list[StoredFile]) -> Manifest:
    """Manifest of a finished dataset."""
    return Manifest(
        scenario=scenario.name,
        scenario_sha256=scenario.sha256,
        seed=scenario.seed,
        skybench=__version__,
        split=spec.split,
        codec=spec.codec,
        shard_size=spec.shard_size,
        exr=spec.exr,
        first=first,
        stop=stop,
        files=tuple(sorted(files, key=lambda file: file.path)),
    )


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write manifest.json atomically."""
    write_bytes(folder / MANIFEST, (json.dumps({"format": FORMAT, **asdict(manifest)}, indent=1) + "\n").encode())


def read_manifest(folder: Path) -> Manifest:
    """Read and check manifest.json.

    Raises
    ------
    GeneratorError
        It is missing (because a run was not finished), is not a manifest, or names a file outside the dataset.
    """
    path = folder / MANIFEST
    manifest = _parsed(manifest_bytes(path, "skybench generate"), str(path))
    for file in manifest.files:
        path_within(folder, file.path)
    return manifest


def manifest_of(target: Target) -> Manifest | None:
    """Return the manifest of a dataset that may be unfinished or damaged; None if there is no readable one."""
    size = target.size(MANIFEST)
    if size is None or size > LARGEST_MANIFEST_BYTES:
        return None
    try:
        return _parsed(target.read(MANIFEST, LARGEST_MANIFEST_BYTES) or b"", target.name)
    except GeneratorError:
        return None


def _parsed(text: bytes, name: str) -> Manifest:
    content = strict_json(text, name, LARGEST_MANIFEST_BYTES)
    try:
        if content.pop("format") != FORMAT:
            raise GeneratorError(f"{name}: not of format {FORMAT}")
        files = listed_files(content.pop("files"))
        texts: dict[str, Any] = {
            key: text_under(content, key) for key in ("scenario", "scenario_sha256", "skybench", "split", "codec")
        }
        counts: dict[str, Any] = {key: count_under(content, key) for key in ("seed", "shard_size", "first", "stop")}
        if not isinstance(content["exr"], bool):
            raise ValueError("exr is neither true nor false")
        if strangers := set(content) - set(texts) - set(counts) - {"exr"}:
            raise ValueError(f"key {min(strangers)} is unknown")
        manifest = Manifest(**texts, **counts, exr=content["exr"], files=files)
        # The split is part of paths, and the codec part of names.
        DatasetSpec(manifest.split, manifest.shard_size, manifest.exr, manifest.codec)
        return manifest
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GeneratorError(f"{name}: not a manifest ({type(error).__name__}: {error})") from error
