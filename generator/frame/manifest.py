"""The manifest of a folder of rendered frames: its files with sizes and hashes, written when all of them are complete."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from generator import __version__
from generator.errors import GeneratorError
from generator.files import path_within, read_at_most, write_bytes
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

FRAMES_MANIFEST = "frames-manifest.json"
FORMAT = "skybench-frames/1"
LARGEST_RECEIPT_BYTES = 100_000
"""Enough for the files of one frame: three, two pictures, and one for each part of the light."""
_OF_FRAME = re.compile(r"frame-([0-9]{5,8})[-.]")


@dataclass(frozen=True)
class FramesManifest:
    """Contents of frames-manifest.json.

    Attributes
    ----------
    scenario, scenario_sha256 : str
    seed : int
    skybench : str
        Version of skybench that wrote the folder.
    frames : int
        Number of frames of the scenario.
    files : tuple of StoredFile
        Every file except the manifest, sorted by path.
    """

    scenario: str
    scenario_sha256: str
    seed: int
    skybench: str
    frames: int
    files: tuple[StoredFile, ...]


def write_frames_manifest(folder: Path, scenario: Scenario, files: list[StoredFile]) -> None:
    """Write the manifest of a finished folder atomically."""
    listed = tuple(sorted(files, key=lambda file: file.path))
    write_manifest(
        folder,
        FramesManifest(scenario.name, scenario.sha256, scenario.seed, __version__, scenario.frame_count, listed),
    )


def write_manifest(folder: Path, manifest: FramesManifest) -> None:
    """Write a manifest atomically; the last file of a folder."""
    text = json.dumps({"format": FORMAT, **asdict(manifest)}, indent=1) + "\n"
    write_bytes(folder / FRAMES_MANIFEST, text.encode())


def read_frames_manifest(folder: Path) -> FramesManifest:
    """Read and check the manifest.

    Raises
    ------
    GeneratorError
        It is missing (because a run was not finished), is not a manifest, or names a file outside the folder.
    """
    path = folder / FRAMES_MANIFEST
    content = strict_json(manifest_bytes(path, "skybench render"), str(path), LARGEST_MANIFEST_BYTES)
    try:
        if content.pop("format") != FORMAT:
            raise GeneratorError(f"{path}: not of format {FORMAT}")
        texts: dict[str, Any] = {key: text_under(content, key) for key in ("scenario", "scenario_sha256", "skybench")}
        counts: dict[str, Any] = {key: count_under(content, key) for key in ("seed", "frames")}
        files = listed_files(content["files"])
        if strangers := set(content) - set(texts) - set(counts) - {"files"}:
            raise ValueError(f"key {min(strangers)} is unknown")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GeneratorError(f"{path}: not a manifest ({type(error).__name__}: {error})") from error
    for file in files:
        path_within(folder, file.path)
    return FramesManifest(**texts, **counts, files=files)


def frame_index(place: str) -> int | None:
    """Return the index of the frame to which a file belongs by its name; None for a table of all frames."""
    found = _OF_FRAME.match(place)
    return int(found[1]) if found else None


def write_frame_receipt(path: Path, files: list[StoredFile]) -> None:
    """Write the list of a frame's files atomically; it marks the frame as complete in an unfinished folder."""
    write_bytes(path, json.dumps([asdict(file) for file in files], indent=1).encode())


def read_frame_receipt(path: Path) -> tuple[StoredFile, ...]:
    """Return a frame's files from its receipt; empty if there is no intact receipt."""
    try:
        return listed_files(strict_json(read_at_most(path, LARGEST_RECEIPT_BYTES), path.name, LARGEST_RECEIPT_BYTES))
    except (OSError, GeneratorError, KeyError, TypeError, AttributeError):
        return ()
