"""Cache of derived tables on disk, with one memory-mapped file per table; everything works without it too.

A file consists of a line of JSON (names, element types, shapes, offsets, size and checksum) and the arrays as they are in
memory, each at a multiple of 64 bytes. Opening a file reads it once for the checksum, at 0.6 ms per megabyte; processes
share the mapped memory. Files contain no pickle and are written atomically. A file that is truncated, damaged or of another
kind is rebuilt.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import mmap
import os
import tempfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[np.generic]]

FORMAT_VERSION = 2
FORMAT = f"celnav-cache/{FORMAT_VERSION}"
ALIGNMENT = 64
LONGEST_HEADER = 1 << 20
PLAIN_KINDS = "biuf"


def cache_dir() -> Path:
    """Return the folder of the cache: ``$XDG_CACHE_HOME/skybench/celnav``, or ``~/.cache/skybench/celnav``."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "skybench" / "celnav"


def digest(*parts: bytes | str) -> str:
    """Return a hash of the parts, in order, as the name of a cached table."""
    state = hashlib.blake2b(digest_size=16)
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        state.update(len(data).to_bytes(8, "little"))
        state.update(data)
    return state.hexdigest()


def cached(name: str, key: str, build: Callable[[], Mapping[str, NDArray[np.generic]]]) -> Arrays:
    """Return the arrays cached under `name` and `key`, building and storing them on the first call.

    Arrays from the cache are read-only. A cache that cannot be read or written costs time, not correctness: the arrays are
    then built again.
    """
    try:
        path = cache_dir() / f"{name}-{key}.{FORMAT_VERSION}.tables"
    except RuntimeError:  # there is no home folder
        return dict(build())
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError), path.open("rb") as file:
        return _map(file)
    arrays = dict(build())
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as target:
                _write(target, arrays)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    return arrays


def _aligned(position: int) -> int:
    return -(-position // ALIGNMENT) * ALIGNMENT


def _write(target: BinaryIO, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    members, position, checksum = {}, 0, 0
    for name, array in arrays.items():
        if array.dtype.kind not in PLAIN_KINDS:
            raise TypeError(f"table {name} holds {array.dtype}, which the cache does not store")
        members[name] = {"dtype": array.dtype.str, "shape": array.shape, "at": position}
        position = _aligned(position + array.nbytes)
        checksum = zlib.crc32(_padded(array), checksum)
    # Offsets count from the end of the header; otherwise they would change its length.
    header = json.dumps({"format": FORMAT, "bytes": position, "crc32": checksum, "members": members}).encode()
    target.write(header.ljust(_aligned(len(header) + 1) - 1) + b"\n")
    for array in arrays.values():
        target.write(_padded(array))


def _padded(array: NDArray[np.generic]) -> bytes:
    return np.ascontiguousarray(array).tobytes() + b"\0" * (_aligned(array.nbytes) - array.nbytes)


def _map(file: BinaryIO) -> Arrays:
    """Map a cache file; raise ValueError, KeyError or TypeError if it is not as written by `_write`."""
    line = file.readline(LONGEST_HEADER)
    header = json.loads(line)
    if header["format"] != FORMAT or os.fstat(file.fileno()).st_size != len(line) + header["bytes"]:
        raise ValueError("no whole file of this format")
    mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    with memoryview(mapped) as content, content[len(line) :] as arrays_content:
        if zlib.crc32(arrays_content) != header["crc32"]:
            raise ValueError("the arrays are damaged")
    arrays: Arrays = {}
    for name, member in header["members"].items():
        dtype = np.dtype(member["dtype"])
        if dtype.kind not in PLAIN_KINDS:
            raise ValueError(f"table {name} holds {dtype}")
        flat = np.frombuffer(mapped, dtype, math.prod(member["shape"]), len(line) + member["at"])
        arrays[name] = flat.reshape(member["shape"])
    return arrays
