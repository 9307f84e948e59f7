"""Commands on a file system that is really full: a small tmpfs, mounted where only the test sees it.

Each command is run until the disk is full, looked at, and run again with room; the result is that of an undisturbed disk.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from small_scenes import BASE
from unit.benchmark.fake_night import write_dataset
from unit.benchmark.fake_results import SOLVERS, TASKS, write_results

from generator.dataset.verify import problems

ROOT = Path(__file__).parents[2]
SKYBENCH = [sys.executable, "-c", "import sys; from benchmark.cli import main; sys.argv[0] = 'skybench'; main()"]
NAMESPACE = ["unshare", "--mount"], ["unshare", "--map-root-user", "--mount"]
# The disk is full, then has room: what each run said and left, one JSON document to a line.
INSIDE = """
import json, os, subprocess, sys
disk, size, temporary, *words = sys.argv[1:]
subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", disk], check=True)
if temporary:
    with open(f"{disk}/full", "wb", buffering=0) as file:
        try:
            while file.write(bytes(4096)): pass
        except OSError: pass
for again in (False, True):
    if again: subprocess.run(["mount", "-o", "remount,size=400m", disk], check=True)
    environment = os.environ | ({"TMPDIR": disk} if temporary else {})
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    files = sorted(os.path.relpath(os.path.join(at, name), disk) for at, _, names in os.walk(disk) for name in names)
    print(json.dumps({"status": done.returncode, "words": done.stdout + done.stderr, "files": files}))
"""


def namespace() -> list[str] | None:
    """Words that run a command where it may mount; None where this system lets nobody."""
    for words in NAMESPACE:
        if (
            shutil.which(words[0])
            and subprocess.run([*words, "true"], capture_output=True, check=False).returncode == 0
        ):
            return words
    return None


# Each test starts the program twice.
pytestmark = [
    pytest.mark.journey,
    pytest.mark.skipif(namespace() is None, reason="this system lets nobody mount a small disk (unshare --mount)"),
]


@pytest.fixture
def scenario(tmp_path) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(BASE | {"frames": 2, "name": "full"}), encoding="utf-8")
    return path


def on_a_full_disk(folder: Path, size: str, *words: str, temporary: bool = False) -> list[dict]:
    """A command that writes to the disk, full and with room; or with its temporary folder there."""
    folder.mkdir(exist_ok=True)
    space = namespace()
    assert space is not None
    done = subprocess.run(
        [*space, sys.executable, "-c", INSIDE, str(folder), size, "x" if temporary else "", *SKYBENCH, *words],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def check(full: dict, again: dict, named: str) -> None:
    """The first run says in words what it lacked; the second ends well."""
    said = " ".join(full["words"].split())
    assert full["status"] == 2, said
    assert "Traceback" not in said
    assert "No space left on device" in said, said
    assert named in said, said
    assert again["status"] == 0, again["words"]


@pytest.mark.parametrize("command", ["render", "generate"])
def test_frames(scenario, tmp_path, command) -> None:
    disk = tmp_path / "disk"
    full, again = on_a_full_disk(disk, "60k", command, str(scenario), "--out", str(disk / "set"))
    check(full, again, str(disk / "set"))
    assert not [name for name in full["files"] if name.endswith((".png", ".tar", "manifest.json"))]
    assert any(name.endswith("manifest.json") for name in again["files"])


def test_runs_of_solvers(tmp_path) -> None:
    disk, night = tmp_path / "disk", write_dataset(tmp_path / "night")
    words = ("bench", "run", str(night), "--solver", "brightest-n", "--out", str(disk / "results"))
    full, again = on_a_full_disk(disk, "8k", *words)
    check(full, again, str(disk / "results"))
    assert not [name for name in full["files"] if name.endswith("summary.json")]
    assert any(name.endswith("summary.json") for name in again["files"])


def test_reports(tmp_path) -> None:
    """The results lie elsewhere; only the site's folder is full."""
    root = write_results(tmp_path / "results", TASKS[:1], SOLVERS[:2], 3, ("own",))
    disk = root / "site"
    full, again = on_a_full_disk(disk, "60k", "bench", "report", "--out", str(root))
    check(full, again, str(disk))
    assert "index.html" not in full["files"] or "site.css" in full["files"]
    assert {"index.html", "site.css"} <= set(again["files"])


def test_temporary_folders(scenario, tmp_path) -> None:
    """Where TMPDIR is full, Python takes the next of the system's temporary folders, and nothing is lost."""
    disk = tmp_path / "disk"
    for done in on_a_full_disk(disk, "40k", "generate", str(scenario), "--out", str(tmp_path / "set"), temporary=True):
        assert done["status"] == 0, done["words"]
    assert problems(tmp_path / "set") == []
