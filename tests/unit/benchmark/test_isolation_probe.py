"""Programs are isolated wherever the system allows it: a fault of ours must not look like a system that forbids it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.solvers.isolation import isolation_obstacle

ROOT = Path(__file__).parents[3]
UNSHARE = ["unshare", "--user", "--map-root-user", "--mount", "--ipc", "--net", "--pid", "--fork", "true"]


def test_namespaces_are_entered_with_the_standard_library_alone() -> None:
    """The guardian runs without site packages, so that a solver's environment cannot change it."""
    program = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import benchmark.solvers.namespaces"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(shutil.which("unshare") is None, reason="util-linux has no unshare here to compare with")
def test_programs_are_isolated_where_the_system_makes_namespaces() -> None:
    allowed = subprocess.run(UNSHARE, capture_output=True, check=False).returncode == 0
    assert not (allowed and isolation_obstacle()), isolation_obstacle()
