"""Links and anchors of Markdown documents, as a forge and the documentation's site interpret them."""

from __future__ import annotations

import posixpath
import re
from dataclasses import dataclass

from pymdownx.slugs import slugify

FENCE = re.compile(r"^(?P<fence>[ ]*(?:`{3,}|~{3,})).*?^(?P=fence)[ ]*$", re.DOTALL | re.MULTILINE)
INLINE_CODE = re.compile(r"(?<!`)(`+)(?!`).+?(?<!`)\1(?!`)", re.DOTALL)
LINK = re.compile(
    r'\]\(\s*<?(?P<inline>[^)\s>]+)>?(?:\s+"[^"]*")?\s*\)'
    r"|^\[[^\]]+\]:\s*<?(?P<reference>[^\s>]+)"
    r'|<(?:a|img)\b[^>]*?\b(?:href|src)="(?P<html>[^"]+)"',
    re.MULTILINE,
)
HEADING = re.compile(r"^(#{1,6})[ \t]+(.+?)[ \t]*#*$", re.MULTILINE)
EXTERNAL = re.compile(r"[a-z][a-z0-9+.-]*:", re.IGNORECASE)

slug = slugify(case="lower")


@dataclass(frozen=True)
class Link:
    """A link's target as written, and its position in the text."""

    target: str
    start: int
    end: int
    line: int

    @property
    def external(self) -> bool:
        """Whether it points outside the repository."""
        return EXTERNAL.match(self.target) is not None or self.target.startswith("//")


def links(text: str) -> list[Link]:
    """All links and pictures of a document, except those in code."""
    plain = without_code(text)
    found = []
    for match in LINK.finditer(plain):
        name = match.lastgroup or "inline"
        start, end = match.span(name)
        found.append(Link(match.group(name), start, end, plain.count("\n", 0, start) + 1))
    return found


def anchors(text: str) -> set[str]:
    """Anchors of a document's headings."""
    fenced = FENCE.sub(_blank, text)
    names: set[str] = set()
    for _, title in HEADING.findall(fenced):
        words = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", title)
        name = slug(words.replace("`", "").replace("*", ""), "-")
        count = 1
        unique = name
        while unique in names:
            unique = f"{name}-{count}"
            count += 1
        names.add(unique)
    return names


def without_code(text: str) -> str:
    """Blank the code in a text; all other characters keep their positions."""
    return INLINE_CODE.sub(_blank, FENCE.sub(_blank, text))


def resolve(source: str, target: str) -> tuple[str, str]:
    """Path in the repository and anchor to which a link in the document `source` points (both with forward slashes)."""
    path, _, anchor = target.partition("#")
    if not path:
        return source, anchor
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), path)), anchor


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match.group())
