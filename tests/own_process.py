"""Running code in a process of its own, for libraries whose open files and deprecations would fail our tests."""

import os
import subprocess
import sys
from pathlib import Path

# The interpreter is left without tearing it down: Arrow's reading threads, which `datasets` starts, sometimes abort there
# after all work is done (https://github.com/apache/arrow/issues/34314).
_LEAVE = "\nimport os, sys\nprint('all ran', flush=True)\nsys.stderr.flush()\nos._exit(0)\n"


def in_a_process_of_its_own(code: str, *arguments: str, cwd: Path | None = None, **environment: str) -> str:
    """Run code to its end; what it prints."""
    run = subprocess.run(
        [sys.executable, "-c", code + _LEAVE, *arguments],
        capture_output=True, text=True, cwd=cwd, env=os.environ | environment, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-500:] + run.stderr[-2000:]
    assert run.stdout.endswith("all ran\n")
    return run.stdout.removesuffix("all ran\n")
