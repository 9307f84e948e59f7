"""`make clean` removes what make made, and nothing that a user put beside it."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MADE = (".venv/bin/python", "out/docs/index.html", "out/demo/frame-00000.png", "out/demo-small/stars.parquet",
        "results/demo/index.html", "results/demo-small/index.html", ".mypy_cache/a", ".hypothesis/examples/a")  # fmt: skip
OWN = (
    "out/my-night/frame-00000.png",
    "out/tasks/bortle@1/stars.parquet",
    "results/leaderboard/index.html",
    "notes.txt",
)

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def cleaned(folder: Path, *places: str) -> set[str]:
    """Files that are left of these after `make clean` in a folder with the project's Makefile."""
    for place in places:
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text("")
    shutil.copy(ROOT / "Makefile", folder)
    subprocess.run(["make", "clean"], cwd=folder, check=True, capture_output=True)
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} - {"Makefile"}


def test_a_users_own_files_stay(tmp_path) -> None:
    assert cleaned(tmp_path, *MADE, *OWN) == set(OWN)


def test_nothing_is_left_of_what_make_made(tmp_path) -> None:
    assert cleaned(tmp_path, *MADE) == set()
    assert not (tmp_path / "out").exists()
    assert cleaned(tmp_path) == set()
