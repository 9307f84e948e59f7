"""Count the revisions of a solver whose results on dev are in the history: python tools/count_revisions.py.

A revision whose results on frames of dev were committed is a try on dev: whoever changed the solver next could see them. Runs
whose results nobody committed leave no trace, so that the tries are at least as many as the changes that were made for their
results. A revision also changes with code that solvers share. Prints a Markdown table, and the number of commits between the
first and the last revision of skybench that change celnav's code (comments and formatting aside). Needs the whole history.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from generator.identity.behaviour import syntax_digest

ROOT = Path(__file__).resolve().parents[1]
RESULTS = "results/leaderboard"
ON_DEV = re.compile(rf"{RESULTS}/[^/]+/dev([-/].*)?\.json")
"""Tables of packed results, and the folders of single ones in early commits."""
CELNAV = ("celnav/*.py", "benchmark/solvers/celnav_solver.py")


@dataclass(frozen=True)
class Change:
    """A file that a commit adds or changes; object names in git, the earlier one empty for an added file."""

    commit: str
    path: str
    before: str
    after: str


def git(repository: Path, *arguments: str, given: str | None = None) -> bytes:
    """Output of a git command."""
    command = ["git", "-C", str(repository), *arguments]
    told = None if given is None else given.encode()
    return subprocess.run(command, input=told, capture_output=True, check=True).stdout


def changes(repository: Path, commits: str, paths: Sequence[str]) -> Iterator[Change]:
    """Changes of some files, the oldest first; a merge is passed over, since the commits that it joins are counted."""
    options = ["--reverse", "--date-order", "--raw", "--no-abbrev", "--no-renames", "-z"]
    log = git(repository, "log", *options, "--format=commit %H", commits, "--", *paths).decode()
    commit, fields = "", iter(log.split("\0"))
    for field in fields:
        for line in field.split("\n"):
            if line.startswith("commit "):
                commit = line.removeprefix("commit ")
            elif line.startswith(":"):
                _, _, before, after, _ = line.split(" ")
                path = next(fields)
                yield Change(commit, path, *("" if set(name) == {"0"} else name for name in (before, after)))


def contents(repository: Path, names: Iterable[str]) -> dict[str, bytes]:
    """Contents of git's objects."""
    asked = sorted(set(names) - {""})
    answer = git(repository, "cat-file", "--batch", given="".join(f"{name}\n" for name in asked))
    found, start = {}, 0
    for name in asked:
        end = answer.index(b"\n", start)
        size = int(answer[start:end].split()[2])
        found[name] = answer[end + 1 : end + 1 + size]
        start = end + size + 2
    return found


def revisions_in(table: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Solvers and revisions of the results in a file; results of early commits state one each."""
    for row in table.get("rows", [table]):
        solver = row.get("provenance", {}).get("solver", {})
        if solver.get("revision"):
            yield solver["target"], solver["revision"]


def tries(repository: Path) -> dict[str, dict[str, str]]:
    """For each solver the revisions with results on dev, in order, and the commit that brought the first result of each."""
    found: dict[str, dict[str, str]] = {}
    brought = [each for each in changes(repository, "HEAD", [RESULTS]) if each.after and ON_DEV.fullmatch(each.path)]
    tables = contents(repository, (each.after for each in brought))
    for each in brought:
        for solver, revision in revisions_in(json.loads(tables[each.after])):
            found.setdefault(solver, {}).setdefault(revision, each.commit)
    return found


def changing_commits(repository: Path, commits: str, paths: Sequence[str]) -> list[str]:
    """Commits that change the code of some Python files, not only their comments, docstrings or formatting."""
    made = list(changes(repository, commits, paths))
    texts = contents(repository, (name for each in made for name in (each.before, each.after)))
    digests = {name: syntax_digest(text.decode()) for name, text in texts.items()} | {"": ""}
    return list(dict.fromkeys(each.commit for each in made if digests[each.before] != digests[each.after]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repository", type=Path, default=ROOT)
    repository = parser.parse_args().repository
    if git(repository, "rev-parse", "--is-shallow-repository").split() == [b"true"]:
        sys.exit("this clone holds a part of the history; get the rest: git fetch --unshallow")
    print("| solver | revisions with results on dev | first | last |\n|-|-|-|-|")
    found = tries(repository)
    for solver, revisions in sorted(found.items(), key=lambda each: (-len(each[1]), each[0])):
        dates = [
            git(repository, "show", "--no-patch", "--format=%cs", commit).decode().strip()
            for commit in revisions.values()
        ]
        print(f"| {solver} | {len(revisions)} | {dates[0]} | {dates[-1]} |")
    commits = list(found.get("skybench", {}).values())
    if commits:
        changed = changing_commits(repository, f"{commits[0]}..{commits[-1]}", CELNAV)
        print(f"\nCommits from {commits[0][:8]} to {commits[-1][:8]} that change celnav's code: {len(changed)}")


if __name__ == "__main__":
    main()
