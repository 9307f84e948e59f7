"""Lists of files with sizes and SHA-256, as in manifests and receipts, and checks of the files against them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from generator.errors import GeneratorError
from generator.files import linked_within, read_at_most

LARGEST_MANIFEST_BYTES = 100_000_000
"""Enough for about half a million files."""


@dataclass(frozen=True)
class StoredFile:
    """A file of a dataset or of a folder of frames: path relative to its root, size and SHA-256."""

    path: str
    bytes: int
    sha256: str


def stored_file(folder: Path, place: str) -> StoredFile:
    """Determine the size and hash of a file."""
    digest = hashlib.sha256()
    size = 0
    with (folder / place).open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
            size += len(block)
    return StoredFile(place, size, digest.hexdigest())


def file_problem(folder: Path, listed: StoredFile) -> str:
    """Describe in one line what is wrong with a listed file; empty for an intact one."""
    try:
        path = linked_within(folder, listed.path)
    except GeneratorError as error:
        return str(error)
    if not path.is_file():
        return f"{listed.path}: missing"
    try:
        size = path.stat().st_size
        if size != listed.bytes:
            return f"{listed.path}: has {size} bytes, the manifest says {listed.bytes}"
        found = stored_file(folder, listed.path)
    except OSError as error:
        return f"{listed.path}: cannot be read ({error.strerror})"
    if found.sha256 != listed.sha256:
        return f"{listed.path}: its contents have changed (SHA-256 differs)"
    return ""


def problems_of_files(
    folder: Path,
    files: Iterable[StoredFile],
    progress: Callable[[str], None],
    problem_of: Callable[[Path, StoredFile], str] = file_problem,
) -> list[str]:
    """Describe what is wrong with listed files, one line each; `progress` is called with each file that has been read."""
    found = []
    for file in files:
        if problem := problem_of(folder, file):
            found.append(problem)
        progress(file.path)
    return found


def manifest_bytes(path: Path, command: str) -> bytes:
    """Read a manifest, which `command` writes as its last file.

    Raises
    ------
    GeneratorError
        It is missing (because a run was not finished), too large, or unreadable.
    """
    try:
        return read_at_most(path, LARGEST_MANIFEST_BYTES)
    except FileNotFoundError as error:
        raise GeneratorError(f"{path}: missing; the run is unfinished: run `{command}` again") from error
    except OSError as error:
        raise GeneratorError(f"{path}: not a manifest ({type(error).__name__}: {error})") from error


def strange_files(folder: Path, known: Iterable[str]) -> list[str]:
    """Return the paths of all files in a folder, at any depth, that are not among the known ones; sorted."""
    present = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    return sorted(present - set(known))


def listed_files(items: Iterable[Mapping[str, Any]]) -> tuple[StoredFile, ...]:
    """Return the files of a parsed list. Raises KeyError, TypeError or AttributeError for anything else."""
    return tuple(
        StoredFile(text_under(item, "path"), count_under(item, "bytes"), text_under(item, "sha256")) for item in items
    )


def text_under(tree: Mapping[str, Any], key: str) -> str:
    """Return a string in a parsed document. Raises KeyError or TypeError."""
    if not isinstance(tree[key], str):
        raise TypeError(f"{key} is no text")
    return str(tree[key])


def count_under(tree: Mapping[str, Any], key: str) -> int:
    """Return a non-negative integer in a parsed document. Raises KeyError or TypeError."""
    if not isinstance(tree[key], int) or isinstance(tree[key], bool) or tree[key] < 0:
        raise TypeError(f"{key} is no number of things")
    return int(tree[key])
