"""Pages of the API reference, one per package and per room (folder of modules), derived from the source tree alone."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("celnav", "generator", "benchmark")


@dataclass(frozen=True)
class Room:
    """A folder of modules: its dotted name, and the dotted names of its public modules."""

    name: str
    modules: tuple[str, ...]

    @property
    def page(self) -> str:
        """Path of its page in the site's sources."""
        return f"api/rooms/{self.name}.md"


def rooms(root: Path, package: str) -> list[Room]:
    """The rooms of a package, the package itself first, in the order of their names."""
    found = []
    for init in sorted((root / package).rglob("__init__.py"), key=lambda path: path.parent.as_posix()):
        parts = init.parent.relative_to(root).parts
        if any(not part.isidentifier() or part.startswith("_") for part in parts):
            continue
        name = ".".join(parts)
        modules = sorted(path.stem for path in init.parent.glob("*.py") if not path.stem.startswith("_"))
        found.append(Room(name, tuple(f"{name}.{module}" for module in modules)))
    return found


def public_modules(root: Path) -> dict[str, str]:
    """The modules that a page in docs/api documents, and the name of that page."""
    pages = sorted((root / "docs" / "api").glob("*.md"))
    return {
        name: page.name
        for page in pages
        for name in re.findall(r"^::: (\S+\.\S+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    }


def room_page(room: Room, elsewhere: dict[str, str]) -> str:
    """Markdown of a room's page: its docstring, then each module; `elsewhere` gives the pages of public modules."""
    parts = [f"# {room.name}\n", directive(room.name, ["show_root_heading: false", "members: false"])]
    for module in room.modules:
        if module in elsewhere:
            parts.append(f"## {module}\n\nDocumented under [{module}](../{elsewhere[module]}#{module}).\n")
        else:
            parts.append(directive(module, ["show_root_heading: true", "heading_level: 2"]))
    return "\n".join(parts)


def directive(name: str, options: list[str]) -> str:
    """The block that mkdocstrings replaces with the documentation of an object."""
    lines = "".join(f"        {option}\n" for option in options)
    return f"::: {name}\n    options:\n{lines}"
