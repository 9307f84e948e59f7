"""The commands that documents show, and the commands that exist: names, options, and whether a command line is acceptable."""

from __future__ import annotations

import functools
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from typer.main import get_command

from benchmark.cli.app import app
from celnav.command.arguments import parser as celnav_parser

ROOT = Path(__file__).parents[1]
PROGRAMS = ("skybench", "celnav")
SHELL = {"", "sh", "bash", "console"}


def skybench_app() -> Any:
    """The Typer application behind the command `skybench`."""
    return app


@functools.cache
def commands_that_exist() -> dict[str, Any]:
    """Every command of `skybench` by its words; groups are left out."""

    def leaves(node: Any, words: list[str]) -> Iterator[tuple[str, Any]]:
        for name, child in getattr(node, "commands", {}).items():
            if hasattr(child, "commands"):
                yield from leaves(child, [*words, name])
            else:
                yield " ".join([*words, name]), child

    return dict(leaves(get_command(skybench_app()), ["skybench"]))


def name_of(line: str, existing: dict[str, Any]) -> str | None:
    """The words of a command line that name its command, if there is such a command."""
    words = line.split()
    for length in (4, 3, 2):
        if " ".join(words[:length]) in existing:
            return " ".join(words[:length])
    return None


def refusal(line: str) -> str | None:
    """Why the command line is not acceptable to the program that it starts; None where it is."""
    words = shlex.split(line, comments=True)
    if words[0] == "celnav":
        try:
            celnav_parser().parse_args(words[1:])
        except SystemExit:
            return "celnav refuses these arguments"
        return None
    existing = commands_that_exist()
    name = name_of(" ".join(words), existing)
    if name is None:
        return "there is no such command"
    try:
        existing[name].make_context(name, words[len(name.split()) :])
    except click.exceptions.ClickException as error:
        return error.format_message()
    except Exception as error:  # Typer may bring a copy of click with exceptions of its own
        return str(error)
    return None


def shown_in_blocks(text: str) -> list[str]:
    """Command lines of `skybench` and `celnav` in a document's blocks of shell code, in their order."""
    lines = []
    for language, block in re.findall(r"^```([a-z]*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if language in SHELL:
            joined = block.replace("\\\n", " ")
            lines += [line.strip() for line in joined.splitlines() if line.startswith(tuple(f"{p} " for p in PROGRAMS))]
    return lines


def shown_in_words(text: str) -> list[str]:
    """Command lines of `skybench` and `celnav` within a document's sentences and tables, as they are written."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    found = re.findall(r"`((?:skybench|celnav) [a-z][^`]*)`", prose)
    return [" ".join(line.replace("\\|", "|").split()) for line in found]


def filled_in(synopsis: str, values: dict[str, str]) -> str:
    """A synopsis with its optional parts, the first of each alternative, and values for the words in capitals."""
    line = synopsis.replace("…", "").replace("[", "").replace("]", "")
    words = [word.split("|")[0] for word in line.split()]
    return " ".join(values.get(word, word) for word in words)
