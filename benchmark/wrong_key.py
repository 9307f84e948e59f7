"""Describe in one sentence what is wrong in a file that people write: the key and what is expected of it."""

from __future__ import annotations

from pydantic import ValidationError


def wrong_key(error: ValidationError) -> str:
    """Name the first key that is wrong and what is wrong with it: ``fuses: Input should be a valid string``."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    what = first["msg"].removeprefix("Value error, ")
    return f"{where}: {what}" if where else what
