"""Solvers that can be run: by name, or from a user's own folder."""

from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from importlib import metadata
from pathlib import Path

from benchmark.errors import SolverError, UnknownSolverError
from benchmark.protocol import SolverUnderTest
from benchmark.solvers.celnav_solver import CelnavSolver
from benchmark.solvers.definition import FOLDER, SPEC_NAME, SolverFolder, read_solver_folder, solver_folders
from benchmark.solvers.learned.adapter import Learned
from benchmark.solvers.ruststartracker.adapter import RustStarTracker
from benchmark.solvers.tetra3rs.adapter import Tetra3rs
from benchmark.solvers.tetra3rs_calibrated.adapter import Tetra3rsCalibrated
from benchmark.solvers.zenith_fixer.adapter import ZenithFixer


def known_solvers() -> tuple[str, ...]:
    """Names of all solvers that come with skybench, sorted."""
    return tuple(sorted(_folders()))


def solvers_by_themselves() -> tuple[str, ...]:
    """Names of these except the fused ones, which answer a frame outside a sequence as the solvers that they wrap."""
    return tuple(sorted(name for name, solver in _folders().items() if solver.fused is None))


def solver_folder(name: str) -> SolverFolder:
    """Find a solver by its name, or by the path of its folder.

    Raises
    ------
    UnknownSolverError
        The message lists the existing names.
    SolverError
        The folder's ``solver.yaml`` is invalid.
    """
    if (Path(name) / SPEC_NAME).is_file():
        return read_solver_folder(Path(name))
    folders = _folders()
    if name not in folders:
        near = get_close_matches(name, folders, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise UnknownSolverError(
            f"unknown solver {name!r}{hint}; known: {', '.join(sorted(folders))}, or a folder with a {SPEC_NAME}"
        )
    return folders[name]


def make_solver(name: str) -> SolverUnderTest:
    """Create a solver in this process by its name.

    Raises
    ------
    UnknownSolverError
        The message lists the existing names.
    SolverError
        It is an external program, or its packages are not installed.
    """
    found = solver_folder(name)
    adapter = found.spec.adapter
    if adapter is None:
        raise SolverError(f"{name}: is a program of its own; it runs on tasks: skybench bench run TASK --solver {name}")
    missing = missing_packages(found)
    if missing:
        raise SolverError(missing_message(found, missing))
    if adapter == "learned":
        return Learned()
    if adapter == "tetra3rs":
        return Tetra3rs()
    if adapter == "tetra3rs-calibrated":
        return Tetra3rsCalibrated()
    if adapter == "ruststartracker":
        return RustStarTracker()
    if adapter == "zenith-fixer":
        return ZenithFixer()
    return CelnavSolver(found.name)


def missing_packages(solver: SolverFolder) -> list[str]:
    """Packages of a solver's adapter that are not installed in the required version."""
    return [each for each in solver.spec.requires if _installed_version(each.split("==")[0]) != each.split("==")[1]]


def _installed_version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def missing_message(solver: SolverFolder, packages: Sequence[str]) -> str:
    """Message that says what to do about missing packages."""
    return f"{solver.name}: needs {' and '.join(packages)}; install with: {solver.spec.install}"


@cache
def _folders() -> dict[str, SolverFolder]:
    return solver_folders(FOLDER)
