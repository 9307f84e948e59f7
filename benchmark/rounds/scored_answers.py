"""The set of answers that counts for each entrant of a round: the first that was scored, whatever happens to its results."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from benchmark.errors import RoundError
from benchmark.frames.frame_set import ALL
from benchmark.rounds.commitment import Commitment, json_bytes, read_json
from benchmark.run.packed import read_packed
from benchmark.run.results import SUMMARY_NAME, read_summary
from generator.files import write_bytes

ANSWERS, FORMAT = "answers.json", "skybench-round-answers/1"
RESULTS = "results"
"""Folder of a round's results in the round's own."""


def settle_answers(folder: Path, committed: Commitment, out: Path, name: str, version: str) -> None:
    """Record an entrant's answers before they are scored, and refuse others: of several, the best would be too good.

    Parameters
    ----------
    folder : Path
        Folder of the round.
    committed : Commitment
    out : Path
        Folder of results, which may be another than the round's.
    name, version : str
        The entrant, and the version of the answers (`benchmark.submit.score.version_of`).

    Raises
    ------
    RoundError
        Others were scored before, or the record cannot be written.
    """
    path = folder / ANSWERS
    recorded = _recorded(path, committed)
    places = () if name in recorded else (folder / RESULTS, out)
    known = {recorded[name]} if name in recorded else set()
    known |= {found for place in places for found in _in_results(place, committed.label, name)}
    if others := sorted(known - {version}):
        raise RoundError(
            f"{name}: answers {others[0]} were scored before, and one set of answers counts; score these ({version}) "
            "with --later"
        )
    content = {
        "format": FORMAT,
        "commitment_sha256": committed.sha256,
        "answers": dict(sorted((recorded | {name: version}).items())),
    }
    try:
        write_bytes(path, json_bytes(content))
    except OSError as error:
        raise RoundError(f"{path}: cannot be written ({error.strerror}), so that no answers are scored") from error


def _recorded(path: Path, committed: Commitment) -> dict[str, str]:
    """Version of the answers of each entrant, by name."""
    if not path.exists():
        return {}
    tree = read_json(path)
    if (tree.get("format"), tree.get("commitment_sha256")) != (FORMAT, committed.sha256):
        raise RoundError(f"{path}: is not of the format {FORMAT} and of this round's commitment; restore it")
    found = tree.get("answers")
    if not isinstance(found, dict) or not all(isinstance(version, str) for version in found.values()):
        raise RoundError(f"{path}: answers must be texts by name; restore it")
    return found


def _in_results(root: Path, label: str, name: str) -> Iterator[str]:
    """Versions of an entrant's answers in results on a round, raw and packed, without those that were kept apart."""
    for path in sorted(root.rglob(f"{name}-*/{SUMMARY_NAME}")):
        stored = read_summary(path)
        frames = stored.provenance.frames
        if (stored.solver, frames.label, frames.split) == (name, label, ALL):
            yield stored.provenance.solver.version
    for listing in sorted(root.glob(f"{label}/{ALL}*.json")):
        for row in read_packed(listing):
            if row.solver == name:
                yield str(row.provenance["solver"]["version"])
