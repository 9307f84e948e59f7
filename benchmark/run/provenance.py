"""Provenance of a result: one complete record, of the same form for all runs."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from benchmark import provenance
from benchmark.errors import ResultsError
from benchmark.frames.frame_set import FrameFacts
from benchmark.wrong_key import wrong_key

DetectionsMode = Literal["own", "shared"]
KEY_DIGITS = 12
UNKNOWN = "not stated"
SEVERAL = "; "
"""Between the machines of a result that was made on several."""


@dataclass(frozen=True)
class SolverFacts:
    """What results say about the solver.

    Attributes
    ----------
    target : str or None
        Argument of `skybench bench run --solver` that runs it; None where no command runs it.
    kind : str
        ``registered``: comes with skybench; ``folder``: the user's own folder; ``object``: a Python object; ``submission``:
        ran elsewhere.
    title, licence, version : str
    detector : str
        Name of the detector whose detections it received.
    revision : str or None
        Digest of its behaviour: a different digest means a different solver. None for a Python object that states none.
    time_limit_s, memory_limit_mib : float or None
        Per frame; None where there was no limit.
    isolation : str or None
        How its program was kept from files and network; None where that is unknown.
    """

    target: str | None
    kind: Literal["registered", "folder", "object", "submission"]
    title: str
    licence: str
    version: str
    detector: str
    revision: str | None
    time_limit_s: float | None
    memory_limit_mib: float | None
    isolation: str | None = None


@dataclass(frozen=True)
class Renewal:
    """Answers that a result takes over from an earlier one, for frames that have not changed (`benchmark.run.renewal`).

    Attributes
    ----------
    n_kept : int
        Frames whose answers are from an earlier run.
    n_solved : int
        Frames that were solved again because they have changed.
    date_utc : str
        When the earlier run ended; the first, if there were several.
    scenario_sha256 : str
    rendered_with : mapping of str to str
        Scenario of that run's frames, and versions of the generator that rendered them.
    """

    n_kept: int
    n_solved: int
    date_utc: str
    scenario_sha256: str
    rendered_with: Mapping[str, str]


@dataclass(frozen=True)
class RunProvenance:
    """Provenance of a result.

    Attributes
    ----------
    frames : FrameFacts
        Frames that were solved.
    solver : SolverFacts
        Solver that solved them.
    detections : str
        ``own``: the solver detected by itself; ``shared``: it received celnav's detections.
    key : str
        See `result_key`.
    versions, machine : mapping of str to str
        See `benchmark.provenance`.
    date_utc : str
        When the run ended.
    jobs : int
        Number of frames that were solved in parallel, which affects the times.
    renewed : Renewal or None
        None where all answers are from one run.
    """

    frames: FrameFacts
    solver: SolverFacts
    detections: DetectionsMode
    key: str
    versions: Mapping[str, str]
    machine: Mapping[str, str]
    date_utc: str
    jobs: int
    renewed: Renewal | None = None


_READER = TypeAdapter(RunProvenance)


def result_key(name: str, solver: SolverFacts, frames: FrameFacts) -> str:
    """Digest of everything that may change a result: solver and its revision, frames and detections."""
    parts = [
        name,
        solver.version if solver.revision is None else solver.revision,
        frames.label,
        frames.definition_sha256 if frames.grading else None,
        frames.scenario_sha256,
        solver.detector,
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:KEY_DIGITS]


def provenance_of(
    name: str, solver: SolverFacts, frames: FrameFacts, detections: DetectionsMode, jobs: int, here: bool = True
) -> RunProvenance:
    """Provenance of a result that has just been produced.

    Parameters
    ----------
    name : str
        Name of the solver.
    solver : SolverFacts
    frames : FrameFacts
    detections : str
    jobs : int
    here : bool
        Whether this machine ran the solver; otherwise the machine is unknown.
    """
    machine = provenance.machine()
    return RunProvenance(
        frames=frames,
        solver=solver,
        detections=detections,
        key=result_key(name, solver, frames),
        versions=provenance.versions(),
        machine=machine if here else dict.fromkeys(machine, UNKNOWN),
        date_utc=provenance.now_utc(),
        jobs=jobs,
    )


def circumstances(source: RunProvenance) -> tuple[object, ...]:
    """What affects answers besides frames and solver: limits, detector, libraries."""
    solver = source.solver
    limits = solver.time_limit_s, solver.memory_limit_mib, solver.isolation
    return (*limits, solver.detector, tuple(sorted(source.versions.items())))


def machines_together(machines: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Combine the descriptions of several machines into one."""
    return {key: SEVERAL.join(dict.fromkeys(one[key] for one in machines)) for key in machines[0]}


def blanks(found: RunProvenance) -> list[str]:
    """Names of texts and mappings that are empty; a value that may be unknown is None instead."""

    def empty(prefix: str, tree: Mapping[str, Any]) -> list[str]:
        names = []
        for key, value in tree.items():
            if value == "" or (key in {"rendered_with", "versions", "machine"} and not value):
                names.append(f"{prefix}{key}")
            elif isinstance(value, Mapping) and key != "grading":  # a pure number has no unit
                names += empty(f"{prefix}{key}.", value)
        return names

    return empty("", dataclasses.asdict(found))


def read_provenance(tree: object) -> RunProvenance:
    """Read a provenance from JSON.

    Raises
    ------
    ResultsError
        The message names the key that is wrong.
    """
    try:
        return _READER.validate_python(tree)
    except ValidationError as error:
        raise ResultsError(f"provenance.{wrong_key(error)}") from error
