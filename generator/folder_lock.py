"""One writer at a time in a folder of frames, by a lock of the operating system, which ends with the process."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from generator.errors import GeneratorError


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Keep other runs on this machine from writing a folder while this one does; the folder is created if it is missing.

    No lock file remains in the folder, however the process ends. On a file system without locks, nobody is kept out.

    Raises
    ------
    GeneratorError
        Another run is writing the folder, or the folder cannot be created.
    """
    if sys.platform == "win32":  # Windows cannot open folders
        yield
        return
    import fcntl

    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise GeneratorError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise GeneratorError(
                f"{folder}: another run is writing it; wait for its end, or choose another folder"
            ) from error
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(handle)
