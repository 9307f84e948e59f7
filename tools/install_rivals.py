"""Install what the contestants of other authors need and this machine lacks: .venv/bin/python tools/install_rivals.py.

Packages of adapters go into the Python that runs this, in the versions of each solver.yaml and without what they depend on,
which the extra `peers` has. Programs with an environment get it ($SKYBENCH_ENVIRONMENTS, or a folder in the user's cache),
made by the same Python. Programs of the system are installed by apt-get, for root alone. What is there already stays as it
is. A failure is printed and costs only its solver: `skybench bench list` names what is missing, and tests that need it skip.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
import venv
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmark.errors import SolverError
from benchmark.solvers.definition import FOLDER, SolverFolder, environments_folder, solver_folders
from benchmark.solvers.registry import missing_packages

PIP = (sys.executable, "-m", "pip")
QUIET = ("--quiet", "--disable-pip-version-check")
Step = tuple[str, Callable[[], None]]
"""What a step installs, and the function that does it."""


class StepError(Exception):
    """A step that failed, in one line."""


def run(*command: str) -> None:
    """Run a command quietly.

    Raises
    ------
    StepError
        With the last line that it printed.
    """
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        words = (done.stderr.strip() or done.stdout.strip() or "failed").splitlines()
        errors = [line for line in words if line.lower().startswith(("error", "e:"))]
        raise StepError((errors or words)[-1][:200])


def steps(solvers: dict[str, SolverFolder]) -> Iterator[Step]:
    """What is to be done for these solvers, each thing once."""
    for solver in solvers.values():
        spec = solver.spec
        if missing := missing_packages(solver):
            yield " and ".join(missing), lambda missing=missing: run(*PIP, "install", *QUIET, "--no-deps", *missing)
        if spec.environment is not None:
            place = environments_folder() / spec.environment
            if not (place / "bin" / "python").is_file():
                needed = solver.folder / "requirements.txt"
                yield f"the environment {place}", lambda place=place, needed=needed: make_environment(place, needed)
        absent = [program for program in spec.programs if shutil.which(program) is None]
        if absent and spec.install is not None:
            yield " and ".join(absent), lambda line=spec.install: install_programs(line)


def make_environment(place: Path, requirements: Path) -> None:
    """Make a virtual environment; nothing is left of one that fails.

    This Python's pip fills it, because Debian's Python may come without the means to put pip into it.
    """
    try:
        venv.create(place, with_pip=False, symlinks=True)
        run(*PIP, "--python", str(place / "bin" / "python"), "install", *QUIET, "--requirement", str(requirements))
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise


def install_programs(line: str) -> None:
    """Run a line of apt-get, where that is possible."""
    words = shlex.split(line)
    if os.geteuid() != 0 or words[0] != "apt-get" or shutil.which("apt-get") is None:
        raise StepError(f"install it by hand: {line}")
    run("apt-get", "update", "--quiet=2")
    run(*words)


def main() -> None:
    try:
        solvers = solver_folders(FOLDER)
    except SolverError as error:
        sys.exit(str(error))
    for what, install in steps(solvers):
        started = time.monotonic()
        try:
            install()
        except (StepError, OSError) as error:
            print(f"no {what}: {error}", flush=True)
        else:
            print(f"installed {what} ({time.monotonic() - started:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
