"""Writing of output files, either completely or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from celnav.errors import ConfigError


def write_whole(path: str | Path, content: str | bytes, option: str) -> None:
    """Write a file that appears under its name only when it is complete.

    Parameters
    ----------
    path : str or Path
        File to write.
    content : str or bytes
        Content; text is written as UTF-8.
    option : str
        Option of the command that names the file, such as ``--out``, for messages.

    Raises
    ------
    ConfigError
        When the file cannot be written; nothing is left behind then.
    """
    target = Path(path)
    try:
        handle, temporary = tempfile.mkstemp(dir=target.resolve().parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
            os.chmod(temporary, 0o666 & ~_umask())
            os.replace(temporary, target)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        raise ConfigError(f"{option} {path}: cannot be written: {error.strerror}") from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
