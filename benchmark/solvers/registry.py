"""Which solvers can be run by name."""

from difflib import get_close_matches

import celnav
from benchmark.errors import UnknownSolverError
from benchmark.solvers.celnav_solver import CelnavSolver
from benchmark.solvers.protocol import SolverUnderTest


def known_solvers() -> tuple[str, ...]:
    """Names that `make_solver` knows, sorted."""
    return tuple(sorted(celnav.solvers()))


def make_solver(name: str) -> SolverUnderTest:
    """Make a contestant by its name.

    Raises
    ------
    UnknownSolverError
        Lists the names that exist.
    """
    known = known_solvers()
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise UnknownSolverError(f"unknown solver {name!r}{hint}; known: {', '.join(known)}")
    return CelnavSolver(name)
