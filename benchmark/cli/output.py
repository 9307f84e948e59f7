"""What commands print: tables for people, or with `--json` one JSON document for programs.

Bars, warnings and errors go to standard error.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.table import Table

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]


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
    r"""Write every character that is not printable as Python does (``\x1b``), but for those that are kept.

    `celnav.command.answer.printable` for commands that load no solver.

    Parameters
    ----------
    text : str
    kept : str
        Characters that stay; none, for what is one line whatever the names in it hold.
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
    if hasattr(value, "model_dump"):  # pydantic, which is not imported for this alone
        return _plain(value.model_dump(mode="json"))
    if hasattr(value, "item"):  # a number of NumPy's
        return _plain(value.item())
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no form in JSON")
