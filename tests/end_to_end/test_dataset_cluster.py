"""Datasets on Ray and in an object store: the same bytes as on one machine, also when a worker dies."""

import hashlib
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest
import yaml
from object_store import served
from small_scenes import BASE

ROOT = Path(__file__).parents[2]
SCENARIO = BASE | {
    "name": "cluster",
    "frames": 12,
    "site": {"latitude_deg": {"uniform": [0, 60]}, "longitude_deg": {"uniform": [0, 60]}},
    "camera": BASE["camera"] | {"width": 96, "height": 64},
    "stars": {"limiting_magnitude": 5.0},
}
CODE = "import sys; from benchmark.cli.app import main; sys.argv[0] = 'skybench'; main()"


def command(scenario: Path, out: str, *more: str) -> list[str]:
    return [sys.executable, "-c", CODE, "generate", str(scenario), "--out", out, "--shard-size", "3", "--json", *more]


def fingerprint(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "logs" not in path.parts
    }


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("cluster") / "cluster.yaml"
    path.write_text(yaml.safe_dump(SCENARIO))
    return path


@pytest.fixture(scope="module")
def local(scenario, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("local") / "dataset"
    subprocess.run(command(scenario, str(folder), "--workers", "0"), check=True, cwd=ROOT, capture_output=True)
    return folder


def kill_a_worker(root: psutil.Process) -> int:
    """Kill the first process under `root` that is seen rendering a shard; 1 if there was one before `root` ended."""
    while root.is_running() and root.status() != psutil.STATUS_ZOMBIE:
        for child in root.children(recursive=True):
            try:
                if any("_render_on_one_thread" in part for part in child.cmdline()):
                    child.kill()
                    return 1
            except psutil.NoSuchProcess:
                continue
        time.sleep(0.01)
    return 0


# Starts a cluster.
@pytest.mark.journey
def test_ray_with_a_killed_worker_gives_the_same_bytes(scenario, local, tmp_path) -> None:
    """Two workers, of which one is killed while it renders; Ray retries its shard."""
    out = tmp_path / "ray"
    arguments = command(scenario, str(out), "--backend", "ray", "--workers", "2")
    environment = os.environ | {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
    with (
        subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment
        ) as process,
        ThreadPoolExecutor(1) as watcher,
    ):
        killed = watcher.submit(kill_a_worker, psutil.Process(process.pid))
        printed, errors = process.communicate()
    assert process.returncode == 0, errors
    assert killed.result() == 1
    assert json.loads(printed.splitlines()[-1]) == {"event": "end", "finished": True, "missing_shards": 0, "mended": []}
    assert fingerprint(out) == fingerprint(local)


@pytest.fixture
def object_store():
    with served() as environment:
        yield environment


DOWNLOAD = """
import sys, fsspec
system = fsspec.filesystem("s3")
if sys.argv[1] == "make":
    system.mkdir("skies")
else:
    system.get("skies/set/", sys.argv[2], recursive=True)
"""


# Six programs and a server.
@pytest.mark.journey
def test_an_object_store_holds_the_same_bytes(scenario, local, tmp_path, object_store) -> None:
    """First half the shards, as an interrupted run leaves them, then the rest; then everything is compared."""
    environment = os.environ | object_store
    subprocess.run([sys.executable, "-c", DOWNLOAD, "make"], check=True, env=environment, capture_output=True)
    half = subprocess.run(
        command(scenario, "s3://skies/set", "--workers", "0", "--part", "0/2"),
        capture_output=True, text=True, env=environment, cwd=ROOT, check=False,
    )  # fmt: skip
    assert half.returncode == 0, half.stderr
    assert json.loads(half.stdout.splitlines()[-1]) == {
        "event": "end",
        "finished": False,
        "missing_shards": 2,
        "mended": [],
    }
    whole = subprocess.run(
        command(scenario, "s3://skies/set", "--workers", "2"),
        capture_output=True, text=True, env=environment, cwd=ROOT, check=False,
    )  # fmt: skip
    assert whole.returncode == 0, whole.stderr
    states = [event["state"] for event in map(json.loads, whole.stdout.splitlines()) if event["event"] == "shard"]
    assert sorted(states) == ["done", "done", "kept", "kept"]
    subprocess.run(
        [sys.executable, "-c", DOWNLOAD, "get", str(tmp_path / "got") + "/"],
        check=True,
        env=environment,
        capture_output=True,
    )
    assert fingerprint(tmp_path / "got") == fingerprint(local)


@pytest.mark.journey
def test_ray_that_cannot_be_reached_is_a_clear_error(scenario, tmp_path) -> None:
    run = subprocess.run(
        command(scenario, str(tmp_path / "out"), "--backend", "ray", "--ray-address", "127.0.0.1:1"),
        capture_output=True, text=True, cwd=ROOT, check=False,
    )  # fmt: skip
    assert run.returncode == 2
    assert "cannot reach a Ray cluster" in run.stderr
