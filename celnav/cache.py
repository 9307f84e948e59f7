"""Cache of derived tables on disk: .npz without pickle, written atomically, of no consequence when it cannot be."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]


def cache_dir() -> Path:
    """Return the folder of the cache: ``$XDG_CACHE_HOME/skybench/celnav``, or ``~/.cache/skybench/celnav``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "skybench" / "celnav"


def digest(*parts: bytes | str) -> str:
    """Return a hash of the parts, in order, that names a cached table."""
    state = hashlib.blake2b(digest_size=16)
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        state.update(len(data).to_bytes(8, "little"))
        state.update(data)
    return state.hexdigest()


def cached(name: str, key: str, build: Callable[[], Mapping[str, NDArray[np.generic]]]) -> Arrays:
    """Return the arrays cached under `name` and `key`, building and storing them where there are none.

    A cache that cannot be read or written costs time, not correctness: the arrays are then built again.
    """
    try:
        path = cache_dir() / f"{name}-{key}.npz"
    except RuntimeError:  # there is no home folder
        return dict(build())
    damaged_or_absent = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)
    with (
        contextlib.suppress(*damaged_or_absent),
        path.open("rb") as file,
        np.load(file, allow_pickle=False) as stored,
    ):
        return {member: stored[member] for member in stored.files}
    arrays = dict(build())
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as target:
                np.savez(target, allow_pickle=False, **arrays)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    return arrays
