"""Output of commands: tables for people, or with `--json` one JSON document for programs.

Progress bars, warnings and errors go to standard error.
"""

from __future__ import annotations

import codecs
import dataclasses
import io
import json
import math
import unicodedata
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

if TYPE_CHECKING:
    from rich.table import Table

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]
_HANDLER = "skybench-plain"
"""Name of the error handler of codecs."""
_LETTERS = {
    "\u2010": "-", "\u2011": "-", "\u2012": "-", "\u2013": "-", "\u2014": "-", "\u2212": "-", "\u2022": "*", "\u00b7": "*",
    "\u00b1": "+-", "\u00d7": "x", "\u2026": "...", "\u2264": "<=", "\u2265": ">=", "\u00b0": " deg", "\u2192": "->",
}  # fmt: skip


def print_json(document: object) -> None:
    """Print a document of mappings, sequences, dataclasses, paths and numbers; infinity and NaN become null."""
    typer.echo(json.dumps(_plain(document), indent=1, allow_nan=False))


def print_tables(*tables: Table) -> None:
    """Print tables for people."""
    from rich.console import Console

    console = Console()
    for table in tables:
        console.print(table)


def print_warnings(sentences: Iterable[str]) -> None:
    """Print warnings to standard error."""
    from rich.console import Console
    from rich.markup import escape

    for sentence in sentences:
        Console(stderr=True).print(
            f"[yellow]warning:[/] {escape(printable(sentence))}", soft_wrap=True, highlight=False
        )


def printable(text: str, kept: str = "\n") -> str:
    r"""Escape every character that is not printable as Python does (``\x1b``), except those that are kept.

    It is `celnav.command.answer.printable` for commands that load no solver.

    Parameters
    ----------
    text : str
    kept : str
        Characters that stay; empty for text that must be one line whatever the names in it contain.
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() or letter in kept else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return _plain(value.value)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return value.as_posix()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "model_dump"):  # pydantic, which is not imported only for this
        return _plain(value.model_dump(mode="json"))
    if hasattr(value, "item"):  # a NumPy number
        return _plain(value.item())
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def let_print(*streams: TextIO) -> None:
    """Let streams accept every text: characters missing from their encoding, such as dashes and signs, are transliterated."""
    codecs.register_error(_HANDLER, _in_plain_letters)
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "backslashreplace"):
            stream.reconfigure(errors=_HANDLER)


def _in_plain_letters(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_letters_for, error.object[error.start : error.end])), error.end


def _letters_for(letter: str) -> str:
    if letter in _LETTERS:
        return _LETTERS[letter]
    simple = unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode("ascii")
    if simple:
        return simple
    return letter.encode("ascii", "backslashreplace").decode("ascii")
