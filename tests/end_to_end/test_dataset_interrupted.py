"""Datasets whose making is broken off: killed processes, dead workers, disks that take no more; then resumed."""

import json
import os
import random
import resource
import signal
import tarfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import psutil
import pytest
from tiny_dataset import SPEC, fingerprint, start

from benchmark.frames.dataset import load_image
from benchmark.frames.sharded import open_sharded
from generator.dataset import shard as shard_module
from generator.dataset.generate import generate
from generator.errors import GeneratorError
from generator.scenario.file import load_scenario

Moment = Callable[[Path], bool]
"""Whether a folder has come to the state, or the clock to the time, at which the program is killed."""


def command(scenario_path: Path, folder: Path, workers: int) -> list[str]:
    return [
        "generate",
        str(scenario_path),
        "--out",
        str(folder),
        "--shard-size",
        "5",
        "--exr",
        "--workers",
        str(workers),
    ]


def begun(folder: Path) -> bool:
    return (folder / "scenario.yaml").exists()


def has_archives(count: int, folder: Path) -> bool:
    return len(list(folder.glob("data/*/shard-*.tar"))) >= count


def is_past(end: float, folder: Path) -> bool:
    return time.monotonic() > end


def kill_at(moment: Moment, scenario_path: Path, folder: Path) -> bool:
    """Start the command and kill it with all its children at a moment; whether it was still running then."""
    with start(*command(scenario_path, folder, 1), start_new_session=True) as process:
        while process.poll() is None and not moment(folder):
            time.sleep(0.005)
        struck = process.poll() is None
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            assert not struck
    for path in folder.glob("data/*/shard-*.tar"):
        with tarfile.open(path) as archive:
            assert archive.getmembers()
    return struck


def finish(scenario_path: Path, folder: Path) -> None:
    with start(*command(scenario_path, folder, 1)) as process:
        _, errors = process.communicate()
    assert process.returncode == 0, errors


# Four times the start of the program and of its worker.
@pytest.mark.journey
def test_killed_and_resumed_gives_the_same_bytes(dataset, scenario_path, tmp_path) -> None:
    moments = [begun, partial(has_archives, 1), partial(has_archives, 2)]
    assert all(kill_at(moment, scenario_path, tmp_path / "killed") for moment in moments)
    finish(scenario_path, tmp_path / "killed")
    assert fingerprint(tmp_path / "killed") == fingerprint(dataset)


# Forty times the start of the program and of its worker.
@pytest.mark.slow
def test_killed_at_twenty_random_moments(dataset, scenario_path, tmp_path) -> None:
    """Twenty runs, each killed once at a random moment of its life, resumed, and compared byte for byte."""
    moments = random.Random(20)
    struck = 0
    for attempt in range(20):
        folder = tmp_path / f"killed-{attempt}"
        struck += kill_at(partial(is_past, time.monotonic() + moments.uniform(0.3, 6.0)), scenario_path, folder)
        finish(scenario_path, folder)
        assert fingerprint(folder) == fingerprint(dataset)
    assert struck >= 10


# Starts the program and two workers.
@pytest.mark.journey
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_nothing_is_left_running(scenario_path, tmp_path, number) -> None:
    """The signal goes to the command alone, not to its workers."""
    with start(*command(scenario_path, tmp_path / "out", 2)) as process:
        while not has_archives(1, tmp_path / "out"):
            assert process.poll() is None
            time.sleep(0.01)
        others = psutil.Process(process.pid).children(recursive=True)
        assert len(others) >= 3
        process.send_signal(number)
        _, errors = process.communicate()
    gone, alive = psutil.wait_procs(others, timeout=20)
    assert (len(gone), alive) == (len(others), [])
    if number == signal.SIGTERM:
        assert process.returncode == 128 + number
        assert "skybench: interrupted; the same command continues" in errors


def test_full_disk_is_a_clear_error_and_leaves_nothing_half(scenario_path, tmp_path, monkeypatch) -> None:
    def full(archive, name, data):
        raise OSError(28, "No space left on device", str(tmp_path / "disk"))

    monkeypatch.setattr(shard_module, "_add", full)
    with pytest.raises(GeneratorError, match=r"No space left on device.*run the same command again"):
        generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "full", SPEC)
    assert list((tmp_path / "full").glob("data/*/*")) == []


# Starts the program, and makes the dataset again.
@pytest.mark.journey
def test_a_file_system_that_refuses_to_grow_leaves_only_whole_files(dataset, scenario_path, tmp_path) -> None:
    """The system's own limit on a file's size stops the writing of the first archive; without it the run goes on."""
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (30_000, 30_000))
    out = tmp_path / "limited"
    with start(*command(scenario_path, out, 0), preexec_fn=limit) as process:
        _, errors = process.communicate()
    assert process.returncode == 2, errors
    assert "File too large" in errors
    assert "run the same command again" in errors
    assert "Traceback" not in errors
    assert sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()) == [
        "logs/train/shard-000000.log", "scenario.yaml",
    ]  # fmt: skip
    generate(load_scenario(scenario_path), scenario_path.read_text(), out, SPEC)
    assert fingerprint(out) == fingerprint(dataset)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into read-only folders")
def test_a_read_only_folder_is_a_clear_error(scenario_path, tmp_path) -> None:
    (tmp_path / "locked").mkdir(mode=0o555)
    with pytest.raises(GeneratorError, match=r"locked.*cannot be written \(Permission denied\); choose another folder"):
        generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "locked" / "set", SPEC)


def test_a_path_that_is_a_file_is_a_clear_error(scenario_path, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GeneratorError, match="cannot be written"):
        generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "file", SPEC)


# Three times the start of a program that renders.
@pytest.mark.journey
def test_a_worker_that_dies_is_replaced(dataset, scenario_path, tmp_path) -> None:
    with start(*command(scenario_path, tmp_path / "out", 1), "--json") as process:
        for line in process.stdout:
            if json.loads(line)["event"] == "frame":
                break
        children = psutil.Process(process.pid).children(recursive=True)
        workers = [child.pid for child in children if "spawn_main" in " ".join(child.cmdline())]
        os.kill(max(workers), signal.SIGKILL)
        events = [json.loads(line) for line in process.stdout]
    assert process.returncode == 0
    assert events[-1] == {"event": "end", "finished": True, "missing_shards": 0, "mended": []}
    assert fingerprint(tmp_path / "out") == fingerprint(dataset)


@pytest.mark.parametrize("damage", ["empty mark", "no mark", "lost image", "mark of another shard"])
def test_an_unpacking_that_was_broken_off_is_continued(small_set, tmp_path, damage) -> None:
    def opened() -> list[int]:
        return [int(load_image(frame).sum()) for frame in open_sharded(str(small_set), tmp_path).frames]

    before = opened()
    marks = sorted(tmp_path.rglob("shards/*.txt"))
    assert marks
    for mark in marks:
        if damage == "no mark":
            mark.unlink()
        elif damage == "lost image":
            for image in tmp_path.rglob("*.png"):
                image.unlink()
        else:
            mark.write_text("" if damage == "empty mark" else "0" * 64 + " 2")
    assert opened() == before
