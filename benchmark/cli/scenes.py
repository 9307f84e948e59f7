"""Scenarios and presets that come with skybench: `skybench scenes` and `skybench presets`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmark.cli import completion
from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables
from generator.errors import GeneratorError
from generator.scenario.quantum_efficiency import QE_CURVES

if TYPE_CHECKING:
    from generator.presets import Preset

LONGEST_ROW = 80
"""Characters of a value in a table; longer lists are cut there, and complete with `--json`."""


def add_to(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(epilog="Examples: skybench scenes; skybench scenes demo; skybench scenes optics --copy mine")(scenes)
    app.command(epilog="Examples: skybench presets; skybench presets imx477-6mm --json")(presets)


def scenes(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="Print this scenario.", autocompletion=completion.shipped),
    ] = None,
    copy: Annotated[
        Path | None,
        typer.Option(
            "--copy", metavar="DIR", help="Copy it (without NAME: all) with the files that it names and the schema."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the scenarios that come with skybench, print one, or copy them as a starting point."""
    from generator.scenario.shipped import copy_scenarios, find_shipped, shipped_scenarios, title_of

    try:
        found = shipped_scenarios() if name is None else {name: find_shipped(name)}
        if copy is not None:
            written = copy_scenarios(found, copy)
            if as_json:
                print_json({"written": written})
            else:
                typer.echo("\n".join(str(path) for path in written))
            return
    except GeneratorError as error:
        fail(error)
    if as_json:
        texts = {key: {"title": title_of(path), "path": path} for key, path in found.items()}
        print_json(texts if name is None else texts[name] | {"text": found[name].read_text(encoding="utf-8")})
        return
    if name is not None:
        typer.echo(found[name].read_text(encoding="utf-8"), nl=False)
        return
    from rich.table import Table

    table = Table("scenario", "what it shows", title="Scenarios: skybench render NAME --out DIR", title_justify="left")
    for key, path in found.items():
        table.add_row(key, title_of(path))
    print_tables(table)


def presets(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="Print all its values.", autocompletion=completion.presets),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List what a scenario can refer to by name: cameras, quantum efficiencies, attitudes, skies, lamps."""
    from generator.presets import KINDS, all_named, preset_named

    if name is None:
        if as_json:
            print_json([preset_named(named.name) for named in all_named()])
            return
        from rich.table import Column, Table

        for kind, usage in KINDS.items():
            table = Table(Column("name", no_wrap=True), "what it is")
            for named in all_named():
                if named.kind == kind:
                    table.add_row(named.name, named.title)
            typer.echo(f"{kind}, written {usage}")
            print_tables(table)
        return
    try:
        preset = preset_named(name)
    except GeneratorError as error:
        fail(error)
    if as_json:
        print_json(preset)
    else:
        _print_preset(preset)


def _print_preset(preset: Preset) -> None:
    from rich.table import Column, Table

    from generator.presets import KINDS

    named = preset.named
    typer.echo(f"{named.name}: {named.title}\nin a scenario: {KINDS[named.kind]}\nsource: {named.source}")
    table = Table(Column("key", no_wrap=True), Column("value", overflow="fold"), "from")
    for values, origin in ((preset.values, "preset"), (preset.defaults, "default")):
        for key, value in _leaves(values):
            table.add_row(key, value, origin)
    print_tables(table)


def _leaves(tree: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """Yield dotted keys, and values as JSON; a curve that has a name by its name."""
    names = {json.dumps([[float(nm), float(part)] for nm, part in curve]): name for name, curve in QE_CURVES.items()}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}{key}.")
        else:
            text = json.dumps(value)
            text = names.get(text, text)
            yield f"{path}{key}", text if len(text) <= LONGEST_ROW else f"{text[:LONGEST_ROW]} … ({len(value)} items)"
