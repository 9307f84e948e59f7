"""Contestants: solvers ready to run, however a user names them – a name, a folder with a solver.yaml, a Python object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import SolverError
from benchmark.protocol import SolverUnderTest
from benchmark.run.fused_session import FusedSession
from benchmark.run.provenance import DetectionsMode, SolverFacts
from benchmark.run.results import check_solver_name
from benchmark.run.sessions import InProcessSession, OtherProcessSession, PipeSession, Session, isolation_of_programs
from benchmark.run.shared_detections import shared_detector
from benchmark.solvers.definition import SolverFolder
from benchmark.solvers.registry import known_solvers, missing_message, missing_packages, solver_folder

SolverChoice = str | Path | SolverFolder | SolverUnderTest
OWN_DETECTOR = "its own"


@dataclass(frozen=True, eq=False)
class Contestant:
    """A solver and the way to create its sessions.

    Attributes
    ----------
    name : str
    target : str or None
        Argument of `--solver` that runs it; None for a Python object.
    definition : SolverFolder or None
    instance : SolverUnderTest or None
        Exactly one of the two is set.
    """

    name: str
    target: str | None
    definition: SolverFolder | None
    instance: SolverUnderTest | None

    @property
    def settled(self) -> bool:
        """Whether its revision is known, so that a finished result of it can be distinguished from one of another solver."""
        return self.definition is not None or _revision(self.instance) is not None

    def obstacle(self) -> str:
        """Why it cannot run here, and what to do about it; empty where it can run."""
        if self.definition is None:
            return ""
        asked = self.definition.asked
        missing = missing_packages(asked)
        if missing:
            return missing_message(asked, missing)
        try:
            asked.command_line()
        except SolverError as error:
            return str(error)
        return ""

    def make_session(self, jobs: int, on_stderr: Callable[[bytes], None] | None = None) -> Session:
        """Create one of `jobs` sessions; `on_stderr` receives what a program writes to its standard error."""
        if self.definition is not None:
            session = PipeSession(self.definition.asked, on_stderr)
            return session if self.definition.fused is None else FusedSession(session)
        assert self.instance is not None
        return InProcessSession(self.instance) if jobs == 1 else OtherProcessSession(self.instance)

    def facts(self, version: str, detections: DetectionsMode) -> SolverFacts:
        """Facts that results state about the solver; `version` is what its session reports."""
        if self.definition is not None:
            spec, asked = self.definition.spec, self.definition.asked
            shipped = self.target in known_solvers()
            return SolverFacts(
                target=self.target,
                kind="registered" if shipped else "folder",
                title=spec.title,
                licence=spec.licence,
                version=version,
                detector=shared_detector() if detections == "shared" else OWN_DETECTOR,
                revision=self.definition.revision,
                time_limit_s=asked.limits.time_s,
                memory_limit_mib=asked.limits.memory_mib,
                # A shipped solver reads nothing but tables that its own files make.
                isolation=isolation_of_programs(() if shipped else asked.spec.reads),
            )
        assert self.instance is not None
        return SolverFacts(
            target=None,
            kind="object",
            title=f"Python object of {type(self.instance).__name__}",
            licence="not stated",
            version=version,
            detector=shared_detector() if detections == "shared" else self.instance.detector,
            revision=_revision(self.instance),
            time_limit_s=None,
            memory_limit_mib=None,
        )


def contestant_of(solver: SolverChoice) -> Contestant:
    """Make a contestant of whatever the user names.

    Raises
    ------
    UnknownSolverError, SolverError, ResultsError
        There is no such solver, its definition is wrong, or its name cannot be used as a file name.
    """
    if isinstance(solver, str | Path):
        definition = solver_folder(str(solver))
        return Contestant(definition.name, str(solver), definition, None)
    if isinstance(solver, SolverFolder):
        target = solver.name if solver.name in known_solvers() else str(solver.folder)
        return Contestant(solver.name, target, solver, None)
    check_solver_name(solver.name)
    return Contestant(solver.name, None, None, solver)


def _revision(instance: SolverUnderTest | None) -> str | None:
    """Revision that a Python object states, if any."""
    found = getattr(instance, "revision", None)
    return found if isinstance(found, str) and found else None
