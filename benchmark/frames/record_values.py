"""Reader of frame records (docs/dataset_format.md): values by key, each checked; every complaint names file and key."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmark.errors import DatasetError
from generator.errors import GeneratorError
from generator.files import read_at_most
from generator.reading.record import FORMAT as FRAME_FORMAT
from generator.reading.record import LARGEST_RECORD_BYTES
from generator.reading.record import read_record as checked_record

__all__ = ["FRAME_FORMAT", "RENDER_AGAIN", "integer", "number", "optional_number", "read_record", "text", "value"]

RENDER_AGAIN = (
    "delete what is damaged and run the same command again, or render the folder again with `skybench render`"
)


def read_record(path: Path) -> dict[str, Any]:
    """Read a frame record. Raises DatasetError where the file is not of this format."""
    try:
        return checked_record(read_at_most(path, LARGEST_RECORD_BYTES), str(path))
    except (GeneratorError, OSError) as error:
        words = f"{path}: {error.strerror}" if isinstance(error, OSError) else str(error)
        raise DatasetError(f"{words}; {RENDER_AGAIN}") from error


def value(path: Path, record: Mapping[str, Any], key: str) -> Any:
    """Look up ``section.name`` in a frame record."""
    found: Any = record
    for part in key.split("."):
        if not isinstance(found, Mapping) or part not in found:
            raise DatasetError(f"{path}: key {key} is missing (docs/dataset_format.md); {RENDER_AGAIN}")
        found = found[part]
    return found


def number(path: Path, record: Mapping[str, Any], key: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Look up a finite number within limits."""
    found = value(path, record, key)
    if isinstance(found, bool) or not isinstance(found, int | float) or not math.isfinite(found):
        raise DatasetError(f"{path}: {key} must be a finite number, found {found!r}")
    if not low <= found <= high:
        raise DatasetError(f"{path}: {key} must lie within {low:g} to {high:g}, found {found!r}")
    return float(found)


def integer(path: Path, record: Mapping[str, Any], key: str, low: int = 0) -> int:
    """Look up an integer of at least `low`."""
    found = value(path, record, key)
    if isinstance(found, bool) or not isinstance(found, int) or found < low:
        raise DatasetError(f"{path}: {key} must be an integer of at least {low}, found {found!r}")
    return found


def text(path: Path, record: Mapping[str, Any], key: str) -> str:
    """Look up a text that is not empty."""
    found = value(path, record, key)
    if not isinstance(found, str) or not found:
        raise DatasetError(f"{path}: {key} must be a text, found {found!r}")
    return found


def optional_number(path: Path, record: Mapping[str, Any], key: str) -> float | None:
    """Look up a number that the records of other generators may omit."""
    section, name = key.split(".")
    found = record.get(section)
    if not isinstance(found, Mapping) or found.get(name) is None:
        return None
    return number(path, record, key)
