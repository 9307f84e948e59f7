"""Contestants of a round, with their revisions."""

from __future__ import annotations

from collections.abc import Sequence

from benchmark.errors import RoundError
from benchmark.run.contestants import contestant_of
from benchmark.run.results import check_solver_name
from benchmark.run.shared_detections import SHARED_DETECTIONS, shared_detector


def settled(solvers: Sequence[str], entrants: Sequence[str]) -> dict[str, str]:
    """Revision of each solver and of the shared detector, and the hash of each entrant's program, by name.

    Raises
    ------
    BenchmarkError
        There is no such solver, an entrant does not have the form NAME=HASH, or a name is given twice.
    """
    found: dict[str, str] = {}
    pairs = [(SHARED_DETECTIONS, shared_detector())] if solvers else []
    for definition in [contestant_of(name).definition for name in solvers]:
        assert definition is not None, "names and folders have definitions"
        pairs.append((definition.name, definition.revision))
    for text in entrants:
        name, _, digest = text.partition("=")
        if not digest:
            raise RoundError(f"--entrant {text!r}: expected NAME=HASH")
        check_solver_name(name)
        pairs.append((name, digest))
    for name, revision in pairs:
        if name in found:
            raise RoundError(f"{name}: is given twice")
        found[name] = revision
    return found
