"""Storage of a dataset: a local folder, or any URL that fsspec supports, such as s3://bucket/name."""

from __future__ import annotations

import errno
import shutil
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from generator.errors import GeneratorError
from generator.files import atomic_path, path_within, read_at_most

INCOMING_PREFIX = ".incoming-"
TRIES_PER_PUT = 3
LARGEST_READ_BYTES = 200_000_000
"""Limit of files that are read completely: manifests, receipts, and files that a scenario names."""
BLOCK_BYTES = 1 << 16
"""Block size of an object that is read in parts: more than the footer of most tables."""


class Target(Protocol):
    """A place for a dataset's files, each named by its path from the dataset's root."""

    @property
    def name(self) -> str:
        """Name for messages."""

    def read(self, place: str, most: int = LARGEST_READ_BYTES) -> bytes | None:
        """Contents of a file of at most `most` bytes, or None if it does not exist."""

    def size(self, place: str) -> int | None:
        """Size of a file in bytes, or None if it does not exist."""

    def put(self, local: Path, place: str) -> None:
        """Store a local file; it appears under its name only when complete."""

    def remove(self, place: str) -> None:
        """Remove a file if it exists."""

    def fetch(self, place: str, scratch: Path, most: int | None = None) -> Path:
        """A local file with the contents of a stored one, copied into the folder `scratch` if necessary.

        At most `most` bytes are copied; a larger file raises OSError.
        """

    def open(self, place: str) -> AbstractContextManager[BinaryIO]:
        """Open a stored file for reading parts of it."""

    def sizes(self, folder: str) -> dict[str, int]:
        """Sizes in bytes of all files under a folder, by their places; empty if the folder does not exist."""

    def listing(self) -> list[str]:
        """Names at the dataset's root."""


@dataclass(frozen=True)
class LocalTarget:
    """A folder on this machine."""

    folder: Path

    @property
    def name(self) -> str:
        """Name for messages."""
        return str(self.folder)

    def read(self, place: str, most: int = LARGEST_READ_BYTES) -> bytes | None:
        """Contents of a file, or None."""
        try:
            return read_at_most(path_within(self.folder, place), most)
        except (FileNotFoundError, NotADirectoryError):
            return None

    def size(self, place: str) -> int | None:
        """Size of a file, or None."""
        path = path_within(self.folder, place)
        return path.stat().st_size if path.is_file() else None

    def put(self, local: Path, place: str) -> None:
        """Copy a file here, from the same file system or another."""
        for tries_left in reversed(range(TRIES_PER_PUT)):
            try:
                with atomic_path(path_within(self.folder, place), prefix=INCOMING_PREFIX) as waiting:
                    shutil.copyfile(local, waiting)
                return
            except FileNotFoundError:
                # Another job of the dataset, when it ends, mistakes temporary files for those of killed jobs.
                if not tries_left or not local.exists():
                    raise

    def remove(self, place: str) -> None:
        """Remove a file."""
        path_within(self.folder, place).unlink(missing_ok=True)

    def fetch(self, place: str, scratch: Path, most: int | None = None) -> Path:
        """The file itself."""
        return path_within(self.folder, place)

    def open(self, place: str) -> BinaryIO:
        """The file itself."""
        return path_within(self.folder, place).open("rb")

    def sizes(self, folder: str) -> dict[str, int]:
        """Sizes of the files under a folder."""
        sizes = {}
        for path in path_within(self.folder, folder).rglob("*"):
            with suppress(FileNotFoundError):  # temporary files of other jobs come and go
                status = path.stat()
                if stat.S_ISREG(status.st_mode):
                    sizes[path.relative_to(self.folder).as_posix()] = status.st_size
        return sizes

    def listing(self) -> list[str]:
        """Names at the root."""
        return sorted(path.name for path in self.folder.iterdir()) if self.folder.is_dir() else []


@dataclass(frozen=True)
class RemoteTarget:
    """An fsspec URL; object stores write objects atomically."""

    url: str

    @property
    def name(self) -> str:
        """Name for messages."""
        return self.url

    @property
    def _is_http(self) -> bool:
        """Whether objects come from an arbitrary web server, so that the stated length of an object may be wrong."""
        return self.url.startswith(("http://", "https://"))

    @contextmanager
    def _open(self, place: str) -> Iterator[tuple[Any, str]]:
        """File system and path of an object; any error of the store is raised as an OSError that names the object."""
        try:
            import fsspec

            system, root = fsspec.core.url_to_fs(self.url)
        except (ImportError, ValueError) as error:
            raise GeneratorError(f"{self.url}: {error}; pip install 'skybench[cluster]'") from error
        try:
            yield system, f"{root}/{place}" if place else root
        except OSError:
            raise
        except Exception as error:  # each store has its own classes, for example for a broken connection
            url = f"{self.url}/{place}" if place else self.url
            raise OSError(errno.EIO, f"{type(error).__name__}: {error}", url) from error

    def read(self, place: str, most: int = LARGEST_READ_BYTES) -> bytes | None:
        """Contents of an object, or None."""
        try:
            with self._open(place) as (system, path):
                if self._is_http:
                    return b"".join(_pieces(system, path, most))
                _check_size(system, path, most)
                return bytes(system.cat_file(path))
        except FileNotFoundError:
            return None

    def size(self, place: str) -> int | None:
        """Size of an object, or None."""
        try:
            with self._open(place) as (system, path):
                system.invalidate_cache()
                return int(system.info(path)["size"])
        except FileNotFoundError:
            return None

    def put(self, local: Path, place: str) -> None:
        """Upload a file."""
        with self._open(place) as (system, path):
            system.put_file(str(local), path)

    def remove(self, place: str) -> None:
        """Remove an object."""
        with self._open(place) as (system, path):
            system.invalidate_cache()
            if system.exists(path):
                system.rm_file(path)

    def fetch(self, place: str, scratch: Path, most: int | None = None) -> Path:
        """Download an object, once."""
        local = path_within(scratch, place)
        if not local.exists():
            local.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(local) as waiting, self._open(place) as (system, path):
                if self._is_http and most is not None:
                    with waiting.open("wb") as stream:
                        stream.writelines(_pieces(system, path, most))
                else:
                    _check_size(system, path, most)
                    system.get_file(path, str(waiting))
        return local

    @contextmanager
    def open(self, place: str) -> Iterator[BinaryIO]:
        """Open an object, of which only the blocks that are read are downloaded."""
        with self._open(place) as (system, path), system.open(path, "rb", block_size=BLOCK_BYTES) as stream:
            yield stream

    def sizes(self, folder: str) -> dict[str, int]:
        """Sizes of the objects under a folder: one request per thousand of them."""
        try:
            with self._open(folder) as (system, path):
                system.invalidate_cache()
                found = system.find(path, detail=True)
                return {
                    f"{folder}/{name.removeprefix(f'{path}/')}": int(entry["size"]) for name, entry in found.items()
                }
        except FileNotFoundError:
            return {}

    def listing(self) -> list[str]:
        """Names at the root."""
        try:
            with self._open("") as (system, path):
                system.invalidate_cache()
                return sorted(Path(entry).name for entry in system.ls(path, detail=False))
        except FileNotFoundError:
            return []


def _pieces(system: Any, path: str, most: int) -> Iterator[bytes]:
    """Yield a web server's response; raises OSError once it exceeds the limit, whatever length was stated."""
    with system.open(path, "rb", block_size=0) as stream:  # 0: one response, not one per block
        left = most
        while piece := stream.read(BLOCK_BYTES):
            left -= len(piece)
            if left < 0:
                raise OSError(errno.EINVAL, f"larger than {most} bytes, and not read", path)
            yield piece


def _check_size(system: Any, path: str, most: int | None) -> None:
    """Check an object's size according to its store. Raises OSError if it is too large."""
    if most is None:
        return
    system.invalidate_cache()
    if int(system.info(path)["size"]) > most:
        raise OSError(errno.EINVAL, f"larger than {most} bytes, and not read", path)


def open_target(out: str) -> Target:
    """Return the target that a user's ``--out`` names: a URL with ``://``, or a local folder."""
    return RemoteTarget(out.rstrip("/")) if "://" in out else LocalTarget(Path(out))
