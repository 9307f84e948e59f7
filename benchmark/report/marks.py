"""Marks: from which sources and revision a page, a figure or a table of measured numbers was produced.

A mark is a comment on its own line, and the next line prints what the mark says::

    <!-- measured {"by": "skybench speed --solver", "of": {"skybench": "979a1c351cf6"}} -->
    *Measured with revision 979a1c351cf6 of skybench.*

``by`` is the command that repeats the measurement. ``of`` names what the numbers describe (`benchmark.report.stale` lists the
permitted names), each with its revision at that time, null where it was not recorded. ``rows`` are patterns of rows of the
leaderboard, which state their revisions themselves, and ``older`` is a digest of those rows that are said not to be of
today's code. ``from`` contains the files from which the numbers were taken, each with the start of its SHA-256. The syntax is
that of comments in Markdown, HTML and SVG alike.
"""

from __future__ import annotations

import hashlib
import html
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.run.freshness import State

SOURCE_DIGITS = 12
_MARK = re.compile(r"^[ \t]*<!-- measured (?P<json>\{.*\}) -->[ \t]*$", re.MULTILINE)
_SENTENCE = re.compile(r"Measured (?:with|before) .*?\.(?=[\s<*]|$)")


@dataclass(frozen=True)
class Mark:
    """Content of a mark.

    Attributes
    ----------
    by : str
        Command that produces the numbers again.
    of : mapping of str to str or None
        Revision of each thing that the numbers describe; None where it was not recorded.
    sources : mapping of str to str
        Files from which the numbers were taken, by path relative to the root, and the start of the SHA-256 of each.
    rows : tuple of str
        Patterns (`fnmatch`) of rows of the leaderboard.
    older : str
        See `older_digest`; empty without rows.
    """

    by: str
    of: Mapping[str, str | None] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    rows: tuple[str, ...] = ()
    older: str = ""

    def line(self) -> str:
        """Format the mark as a comment."""
        tree: dict[str, object] = {
            "by": self.by,
            "of": dict(self.of),
            "from": dict(self.sources),
            "rows": list(self.rows),
            "older": self.older,
        }
        tree = {name: value for name, value in tree.items() if value}
        text = json.dumps(tree, ensure_ascii=False, sort_keys=True)
        # Two hyphens would end the comment.
        return "<!-- measured " + text.replace("--", "-\\u002d") + " -->"


@dataclass(frozen=True)
class Printed:
    """A mark found in a file.

    Attributes
    ----------
    mark : Mark
    line_number : int
        Line number of the mark, from 1.
    sentence : str
        The sentence on the next line; empty where that line holds no such sentence.
    """

    mark: Mark
    line_number: int
    sentence: str


def sentence_of(mark: Mark, states: Mapping[str, State]) -> str:
    """Sentence that must be printed next to numbers.

    Parameters
    ----------
    mark : Mark
    states : mapping of str to State
        State of each name in ``mark.of``, or of each row that its patterns match.
    """
    if mark.rows:
        return _counted(states)
    known = [(name, revision) for name, revision in mark.of.items() if revision is not None]
    unknown = " and ".join(name for name, revision in mark.of.items() if revision is None)
    if not known:
        return f"Measured before revisions of {unknown} were recorded."
    words = [
        f"revision {revision} of {name}" + (", which is not today's" if states[name] is State.OLDER else "")
        for name, revision in known
    ]
    if unknown:
        words.append(f"a revision of {unknown} that was not recorded")
    return f"Measured with {' and '.join(words)}."


def _counted(states: Mapping[str, State]) -> str:
    count = {state: sum(found is state for found in states.values()) for state in State}
    parts = [f"{count[State.TODAY]} of today's code"]
    if count[State.OLDER]:
        parts.append(f"{count[State.OLDER]} of older revisions")
    if count[State.UNRECORDED]:
        parts.append(f"{count[State.UNRECORDED]} of revisions that were not recorded")
    return f"Measured with {len(states)} results: {', '.join(parts)}."


def older_digest(states: Mapping[str, State]) -> str:
    """Start of the SHA-256 of the names that are of an older revision."""
    older = sorted(name for name, state in states.items() if state is State.OLDER)
    return hashlib.sha256("\n".join(older).encode()).hexdigest()[:SOURCE_DIGITS]


def stated_path(path: Path) -> str:
    """Path of a file relative to the working folder; outside it only the name, since a path reveals where somebody works."""
    here, place = Path.cwd(), path.resolve()
    return place.relative_to(here).as_posix() if place.is_relative_to(here) else path.name


def source_digest(path: Path) -> str:
    """Start of a file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:SOURCE_DIGITS]


def find_marks(text: str) -> list[Printed]:
    """Find all marks in a file.

    Raises
    ------
    ValueError
        One of them cannot be read.
    """
    found = []
    for match in _MARK.finditer(text):
        number = text.count("\n", 0, match.start()) + 1
        following = text[match.end() + 1 :].split("\n", 1)[0]
        sentence = _SENTENCE.search(following)
        found.append(Printed(_read(match["json"], number), number, html.unescape(sentence.group()) if sentence else ""))
    return found


def restamp(text: str, printed: Printed, mark: Mark, sentence: str) -> str:
    """Replace a mark and the sentence after it.

    Raises
    ------
    ValueError
        The line after the mark holds no such sentence.
    """
    lines = text.split("\n")
    place = printed.line_number
    if place >= len(lines) or not _SENTENCE.search(lines[place]):
        raise ValueError(f"line {place + 1} must hold the words 'Measured with …' or 'Measured before …'")
    lines[place - 1] = mark.line()
    lines[place] = _SENTENCE.sub(lambda _: sentence, lines[place], count=1)
    return "\n".join(lines)


def _read(text: str, number: int) -> Mark:
    try:
        tree = json.loads(text)
        of = {str(name): None if value is None else str(value) for name, value in tree.get("of", {}).items()}
        sources = {str(name): str(value) for name, value in tree.get("from", {}).items()}
        rows = tuple(str(pattern) for pattern in tree.get("rows", []))
        mark = Mark(str(tree["by"]), of, sources, rows, str(tree.get("older", "")))
        unknown = set(tree) - {"by", "of", "from", "rows", "older"}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"line {number}: not a readable mark ({error!r})") from error
    if unknown or bool(mark.of) == bool(mark.rows):
        raise ValueError(f"line {number}: a mark has the keys by, of or rows, from and older")
    return mark
