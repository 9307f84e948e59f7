"""The commits that docs/rounds.md gives for the rounds contain the generators that the rounds were committed to with."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.rounds.commitment import read_commitment

ROOT = Path(__file__).parents[3]
ORDINALS = (
    "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth", "eleventh", "twelfth",
    "thirteenth", "fourteenth", "fifteenth", "sixteenth", "seventeenth", "eighteenth", "nineteenth", "twentieth",
)  # fmt: skip
ROUNDS = sorted((ROOT / "results" / "rounds").glob("*/commitment.json"))


def commits_of_rounds() -> dict[int, str]:
    """Commit of each round, counted from 0, as the paragraph about `verify` lists them."""
    text = " ".join((ROOT / "docs" / "rounds.md").read_text(encoding="utf-8").split())
    (listed,) = re.findall(r"of the commitment: (.*?)\. ", text)
    parts = re.findall(r"`(?:git checkout )?([0-9a-f]{7,40})` for the (\w+)(?: round)?(?: to the (\w+))?", listed)
    return {
        number: commit
        for commit, last, first in parts
        for number in range(ORDINALS.index(first or last), ORDINALS.index(last) + 1)
    }


COMMITS = commits_of_rounds()


def git(*words: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True)


def test_every_round_has_a_commit() -> None:
    assert sorted(COMMITS) == list(range(len(ROUNDS)))


@pytest.mark.journey
@pytest.mark.parametrize("commit", sorted(set(COMMITS.values())))
def test_the_commit_of_a_round_has_its_generator(commit: str, tmp_path: Path) -> None:
    """That commit's own code says its revision, because the rule of revisions may have changed since."""
    if git("cat-file", "-e", f"{commit}^{{commit}}").returncode:
        pytest.skip(f"{commit} is not in this copy of the repository: it has no history, or not all of it")
    packed = git("archive", commit, "generator").stdout
    subprocess.run(["tar", "-x", "-C", str(tmp_path)], input=packed, check=True)
    code = "from generator.identity.revision import generator_revision; print(generator_revision())"
    said = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()
    for number, place in enumerate(ROUNDS):
        if COMMITS[number] == commit:
            committed, _ = read_commitment(place.parent)
            assert committed.terms.generator_revision == said, place.parent.name
