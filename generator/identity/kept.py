"""Arrays that take a second to compute, cached between processes in the user's cache folder.

Every worker computes the same tables at its start: transfer from a city to the sky, point spread functions of a lens, the
map of the Milky Way. They are stored under a hash of everything on which they depend: their inputs, the generator's
revision (so that tables of other code are never read), the versions of NumPy and SciPy, and the processor's instructions,
which determine the order of sums. A cached table is therefore identical to the computed one, to the bit, and deleting the
folder only costs time.

The files are NumPy's (.npz, no pickle), with a checksum for each array. The contents of a damaged file are computed
again, and so is everything if the folder cannot be written. The least recently used files are deleted if there are more
than MOST_BYTES.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import os
import platform
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import platformdirs
import scipy
from numpy.typing import NDArray
from pydantic import BaseModel
from threadpoolctl import threadpool_info

from generator.files import write_bytes
from generator.identity.revision import generator_revision

Arrays = dict[str, NDArray[np.generic]]

FOLDER = "tables"
MOST_BYTES = 400_000_000
"""Limit of the size of all files together."""
MOST_BYTES_EACH = 100_000_000
MOST_WRITTEN = 8
"""Limit of the files that one process writes for each name: if every frame has a lens of its own, caching all of them is
useless."""

_written: Counter[str] = Counter()


def kept(name: str, inputs: tuple[object, ...], make: Callable[[], Mapping[str, NDArray[np.generic]]]) -> Arrays:
    """Return arrays by name: cached ones of an earlier process, or those of `make`.

    Parameters
    ----------
    name : str
        Name of the computed arrays; letters, digits and hyphens.
    inputs : tuple
        Everything on which `make` depends: numbers, strings, None, and tuples, data classes and models of these.
    make : callable
        Computes the arrays, which must not contain objects.

    Raises
    ------
    TypeError
        An input is of another kind, whose text might not be unique.
    """
    path = platformdirs.user_cache_path("skybench") / FOLDER / f"{name}-{_key(inputs)}.npz"
    known = _read(path)
    if known is not None:
        return known
    # Computed arrays have the same order in memory as arrays that were read, so that sums over them are the same.
    made = {key: np.ascontiguousarray(array) for key, array in make().items()}
    _keep(name, path, made)
    return made


def described(value: object) -> str:
    """A text that distinguishes a value from every other of its kind. Raises TypeError as :func:`kept`."""
    if value is None or isinstance(value, bool | int | str):
        return repr(value)
    if isinstance(value, float):
        return float.__repr__(value)
    if isinstance(value, tuple):
        return f"({','.join(map(described, value))})"
    if isinstance(value, BaseModel):
        fields = [(field, getattr(value, field)) for field in type(value).model_fields]
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    else:
        raise TypeError(f"{type(value).__name__} has no text that tells it from others")
    return f"{type(value).__qualname__}({','.join(f'{field}={described(each)}' for field, each in fields)})"


def _key(inputs: tuple[object, ...]) -> str:
    return hashlib.sha256(f"{_surroundings()}:{described(inputs)}".encode()).hexdigest()[:32]


@functools.cache
def _surroundings() -> str:
    """Further dependencies of the numbers: code, libraries, and the instructions that these choose on this processor."""
    kernels = sorted({library["architecture"] for library in threadpool_info() if "architecture" in library})
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    return ":".join([generator_revision(), np.__version__, scipy.__version__, platform.machine(), *kernels, *found])


def _read(path: Path) -> Arrays | None:
    try:
        if path.stat().st_size > MOST_BYTES_EACH:
            return None
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        os.utime(path)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return arrays


def _keep(name: str, path: Path, arrays: Arrays) -> None:
    """Write arrays, and remove the least recently used files; failures are ignored."""
    if _written[name] >= MOST_WRITTEN or sum(array.nbytes for array in arrays.values()) > MOST_BYTES_EACH:
        return
    _written[name] += 1
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    try:
        write_bytes(path, content.getvalue())
        files = [(each, each.stat()) for each in path.parent.glob("*.npz")]
        total = 0
        for each, state in sorted(files, key=lambda file: file[1].st_mtime, reverse=True):
            total += state.st_size
            if total > MOST_BYTES:
                each.unlink(missing_ok=True)
    except OSError:
        return  # an unwritable folder only costs the time
