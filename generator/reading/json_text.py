"""JSON from other parties: finite numbers, encodable strings, and no more levels or bytes than a format needs."""

from __future__ import annotations

import json
import math
from typing import Any

from generator.errors import GeneratorError

MOST_LEVELS = 16
"""Limit of nesting. The deepest format has 5 levels; recursion in readers and printers stays far from its limit."""
LARGEST_INTEGER = 2**63 - 1
"""Largest integer of NumPy and Arrow; a JSON number may have any number of digits."""


def strict_json(data: bytes | str, name: str, most_bytes: int) -> Any:
    """Parse JSON.

    Parameters
    ----------
    data : bytes or str
    name : str
        Name of the file, and of the frame in it, for messages.
    most_bytes : int
        Size of the largest text that is parsed.

    Raises
    ------
    GeneratorError
        The text is not JSON, or contains NaN, infinity, an integer beyond 64 bits, more than MOST_LEVELS levels, or lone
        surrogates.
    """
    if len(data) > most_bytes:
        raise GeneratorError(f"{name}: {len(data)} bytes of JSON, more than {most_bytes}; it is not read")
    try:
        found = json.loads(data, parse_constant=_refused_constant)
    except RecursionError as error:
        raise GeneratorError(f"{name}: nested deeper than {MOST_LEVELS} levels; it is not read") from error
    except ValueError as error:
        raise GeneratorError(f"{name}: not readable as JSON ({str(error)[:200]})") from error
    _check(found, name)
    return found


def _refused_constant(word: str) -> float:
    raise ValueError(f"{word} is no number of JSON")


def _check(tree: Any, name: str) -> None:
    """Refuse values that a later reader cannot handle, level by level."""
    level = [tree]
    for _ in range(MOST_LEVELS):
        below: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                below += item.keys()
                below += item.values()
            elif isinstance(item, list):
                below += item
            elif isinstance(item, float):
                if not math.isfinite(item):
                    raise GeneratorError(f"{name}: has a number that is not finite")
            elif isinstance(item, str):
                if not item.isascii() and any("\ud800" <= character <= "\udfff" for character in item):
                    raise GeneratorError(f"{name}: has half a character, which cannot be written as UTF-8")
            elif isinstance(item, int) and abs(item) > LARGEST_INTEGER:
                raise GeneratorError(f"{name}: has an integer of {item.bit_length()} bits, more than 64")
        if not below:
            return
        level = below
    raise GeneratorError(f"{name}: nested deeper than {MOST_LEVELS} levels; it is not read")
