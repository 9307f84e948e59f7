"""Run the commands of docs/journeys.md again and insert their output below them.

Usage: python tools/journeys.py   (skybench must be on the PATH; works in a temporary folder)

The document contains files (blocks that begin with ``# file: NAME``) and console blocks, in which lines after ``$ `` are
commands and the others are their output. Standard output and standard error are shown as in a terminal, without progress
bars. A line ``exit status N`` follows a command that fails.
"""

import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "journeys.md"
WIDTH = 120
HOME = "/home/you"
"""Replaces the folder in which the commands run."""
LONGEST_S = 600
_FENCED = re.compile(r"^```(\w+)\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
_FILE = re.compile(r"# file: (\S+)\n")
_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")
_BORDERS = ("┏", "┡")
_PROGRESS = re.compile(r"[━╸╺]{3,}|\d+/\d+.*-?\d*-?:\S\S:\S\S")
# What differs between runs and machines: times, rates, and sizes of memory.
_VARYING = re.compile(r"\b\d+(?:\.\d+)?(?= ?(?:s|ms|min|h|frames/s|MB|GB|MiB|GiB|cores?)\b)")
# Digests of frames, which depend on their last digits; another kind of processor may give different ones.
_IDENTITY = re.compile(r"@[0-9a-f]{12}\b")


@dataclass(frozen=True)
class Typed:
    """A command and its output."""

    command: str
    printed: str

    @property
    def without_times(self) -> str:
        """Output with identities removed, times and sizes replaced by a sign, and runs of blanks or rules reduced to one.

        Line ends count as blanks, because the width of a table depends on its times, and the text above it wraps accordingly.
        """
        lines = [
            re.sub(r"\d+(\.\d+)?", "N", line) if "time" in line else line
            for line in _VARYING.sub("N", _IDENTITY.sub("@", self.printed)).splitlines()
        ]
        return " ".join(word for line in lines for word in re.sub("([─━])+", r"\1", line).split())


def parts_of(page: str) -> Iterator[re.Match[str] | list[Typed]]:
    """Yield files to write, as matches of name and content, and console blocks, in order."""
    for block in _FENCED.finditer(page):
        language, text = block.groups()
        if _FILE.match(text):
            yield block
        elif language == "console":
            yield [Typed(*typed.partition("\n")[::2]) for typed in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]]


def run(command: str, folder: Path) -> Typed:
    """Run a command line in a folder."""
    environment = os.environ | {"COLUMNS": str(WIDTH), "NO_COLOR": "1", "TERM": "dumb"}
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    text = _ESCAPES.sub("", done.stdout).replace(str(folder), HOME)
    lines = [line.rstrip() for line in text.splitlines()]
    kept = [line for line in lines if line.startswith(_BORDERS) or not _PROGRESS.search(line)]
    if done.returncode:
        kept.append(f"exit status {done.returncode}")
    return Typed(command, "".join(f"{line}\n" for line in kept))


def run_page(page: str, folder: Path) -> str:
    """The page with the present output of its commands, run in an empty folder."""
    made, end = [], 0
    for block in _FENCED.finditer(page):
        language, text = block.groups()
        if named := _FILE.match(text):
            path = folder / named.group(1)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text[named.end() :], encoding="utf-8")
        elif language == "console":
            typed = [run(line.partition("\n")[0], folder) for line in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]]
            shown = "".join(f"$ {one.command}\n{one.printed}" for one in typed)
            made.append(page[end : block.start(2)] + shown)
            end = block.end(2)
    return "".join(made) + page[end:]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        PAGE.write_text(run_page(PAGE.read_text(encoding="utf-8"), Path(folder).resolve()), encoding="utf-8")


if __name__ == "__main__":
    main()
