"""One writer at a time in a folder of frames: the system's lock on the folder, which ends with its process."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from generator.errors import GeneratorError


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Keep other runs on this machine out of a folder while this one writes it; the folder is made if it is missing.

    Nothing is left in the folder, whenever the process ends. A file system without locks lets everybody in.

    Raises
    ------
    GeneratorError
        Another run writes the folder, or it cannot be made.
    """
    if sys.platform == "win32":  # folders cannot be opened there
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
