"""Files: written completely or not at all, never outside the requested folder, and read within size limits."""

from __future__ import annotations

import errno
import functools
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from generator.errors import GeneratorError


@contextmanager
def atomic_path(path: Path, prefix: str = "") -> Iterator[Path]:
    """Yield a temporary path next to `path`; on success flush it to disk and rename it to `path`.

    The folder is created if it is missing. On any error the temporary file is removed and `path` is left unchanged.

    Parameters
    ----------
    path : Path
        The final name.
    prefix : str
        Start of the temporary name, by which files left by killed processes can be found; by default a dot and the stem
        of `path`. The temporary name keeps the suffix of `path`, for writers that choose a format by it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=prefix or f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        temporary.chmod(0o644 & ~_umask())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@functools.cache
def _umask() -> int:
    """Return this process' umask. It can only be read by setting it, so this is done once."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path` atomically; the folder is created if it is missing."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def read_at_most(path: Path, most: int) -> bytes:
    """Read a file of unknown origin, which must be a regular file of at most `most` bytes.

    The type and size are those of the opened file, because a path can lead to an endless device or to a pipe that waits
    for a writer.

    Raises
    ------
    OSError
        The file cannot be read, is not a regular file, or is larger.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(handle, "rb") as stream:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        data = stream.read(min(status.st_size, most) + 1)
    if len(data) > most:
        raise OSError(errno.EINVAL, f"larger than {most} bytes, and not read", str(path))
    return data


def read_text_at_most(path: Path, most: int) -> str:
    """Read a UTF-8 text as `read_at_most` does, with single newlines as line ends. Raises OSError or UnicodeDecodeError."""
    return read_at_most(path, most).decode("utf-8").replace("\r\n", "\n")


def path_within(folder: Path, place: str) -> Path:
    """Join a folder and a relative path with / between its parts, such that the result is inside the folder.

    Every name that comes from a file of unknown origin must pass through this function before it is used to open
    anything. Links inside the folder are not resolved.

    Raises
    ------
    GeneratorError
        `place` is empty, absolute or not in its shortest form, has a part ``..``, or contains a backslash or a control
        character.
    """
    relative = PurePosixPath(place)
    shortest = str(relative) == place and place != "."
    if not shortest or relative.is_absolute() or ".." in relative.parts or "\\" in place or not place.isprintable():
        raise GeneratorError(
            f"{folder}: {place!r} is not a plain relative path and could lie outside the folder; it is not used"
        )
    return folder / place


def linked_within(folder: Path, place: str) -> Path:
    """Join a folder and a relative path as `path_within` does, and refuse a link that leads out of the folder.

    This is for folders with files from a third party, who could otherwise use a link to expose files outside the
    folder.

    Raises
    ------
    GeneratorError
        As for `path_within`; or a part of the path is a link that leads out of the folder or to itself.
    """
    path = path_within(folder, place)
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # Python up to 3.12 raises RuntimeError for circular links
        inside = False
    if not inside:
        raise GeneratorError(
            f"{path}: is a link that leads out of {folder}; it is not followed: put a copy of the file in its place"
        )
    return path
