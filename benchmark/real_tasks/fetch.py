"""Photographs of tasks, fetched by address or taken from a folder, and identified by their SHA-256."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable
from pathlib import Path

from benchmark.errors import TaskError
from benchmark.real_tasks.definition import RealTask, Source
from generator.files import write_bytes

SOURCES = "sources"
"""Folder of a task's photographs among its frames."""
TIMEOUT_S = 30.0
_ENDINGS = ("", ".gz", ".bz2")


def sources_folder(task: RealTask, data: Path) -> Path:
    """Folder in which a task's photographs are kept."""
    return data / task.label / SOURCES


def missing_sources(task: RealTask, data: Path) -> list[Source]:
    """Photographs of a task that are missing or not the expected files."""
    folder = sources_folder(task, data)
    return [source for source in task.definition.sources if not _is_whole(folder / source.file, source)]


def fetch_sources(
    task: RealTask, data: Path, folder: Path | None = None, progress: Callable[[str], None] = lambda file: None
) -> list[str]:
    """Fetch the missing photographs of a task.

    Parameters
    ----------
    task : RealTask
    data : Path
        Folder of all frames.
    folder : Path, optional
        A folder that contains the photographs at any depth, possibly compressed (.gz, .bz2); nothing is fetched from
        elsewhere.
    progress : callable
        Called with each file that has arrived.

    Returns
    -------
    list of str
        Files that have arrived.

    Raises
    ------
    TaskError
        A photograph cannot be fetched, or is not the one of the task; the message says what to do.
    """
    came = []
    for source in missing_sources(task, data):
        content = _from_address(task, source) if folder is None else _from_folder(task, source, folder)
        try:
            write_bytes(sources_folder(task, data) / source.file, content)
        except OSError as error:
            raise TaskError(f"{error.filename or data}: cannot be written ({error.strerror})") from error
        came.append(source.file)
        progress(source.file)
    return came


def _from_address(task: RealTask, source: Source) -> bytes:
    address, elsewhere = task.address_of(source), _elsewhere(task)
    if address is None:
        raise TaskError(
            f"{task.label}: no address of {source.published or source.file} is known; it was published in "
            f"{task.definition.origin}. {elsewhere}"
        )
    try:
        with urllib.request.urlopen(address, timeout=TIMEOUT_S) as stream:  # the definition allows only https
            content: bytes = stream.read(source.bytes + 1)
    except (urllib.error.URLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise TaskError(f"{address}: cannot be fetched ({reason}). {elsewhere}") from error
    if not _is(content, source):
        raise TaskError(f"{address}: is not the photograph of the task (SHA-256 differs); nothing is kept. {elsewhere}")
    return content


def _from_folder(task: RealTask, source: Source, folder: Path) -> bytes:
    if not folder.is_dir():
        raise TaskError(f"{folder}: no such folder")
    refused = None
    for ending in _ENDINGS:
        for path in sorted(folder.rglob(f"{source.published or source.file}{ending}")):
            # A file of the right size, or a compressed one that cannot be much larger than its content.
            if not path.is_file() or path.stat().st_size > source.bytes + 100_000:
                refused = path
                continue
            try:
                content = _bounded(path, ending, source) if ending else path.read_bytes()
            except (OSError, EOFError, zlib.error, ValueError) as error:
                raise TaskError(f"{path}: cannot be read ({error})") from error
            if _is(content, source):
                return content
            refused = path
    if refused is not None:
        raise TaskError(f"{refused}: is not the photograph of {task.label} (SHA-256 differs)")
    raise TaskError(f"{folder}: {source.published or source.file} is not in it, nor in a folder below")


def _bounded(path: Path, ending: str, source: Source) -> bytes:
    """Unpack a file, and no more of it than the photograph's size."""
    with gzip.open(path) if ending == ".gz" else bz2.open(path) as stream:
        return stream.read(source.bytes + 1)


def _elsewhere(task: RealTask) -> str:
    return f"With the files at hand: skybench fetch {task.definition.name} --from FOLDER"


def _is(content: bytes, source: Source) -> bool:
    return len(content) == source.bytes and hashlib.sha256(content).hexdigest() == source.sha256


def _is_whole(path: Path, source: Source) -> bool:
    try:
        return path.stat().st_size == source.bytes and _is(path.read_bytes(), source)
    except OSError:
        return False
