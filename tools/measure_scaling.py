"""Two jobs of one dataset in an object store, compared with one: python tools/measure_scaling.py --frames 200 --turns 3.

Each turn runs one job that makes the first half of the shards, then two jobs in parallel that make a half each
(`skybench generate --shards`, one process per job), as whole processes including their start. Then it does the same with a
local folder, which shows what the machine itself can do. It prints frames per second, the ratio of the two rates turn by
turn, the processor time of the jobs and of the store, and the requests and bytes that the store received. The store is moto's
server on this machine. Its work occupies a core, which affects two jobs but hardly one; the highest rate that two jobs can
reach next to it is printed too. Needs the extra `cluster` of pyproject.toml, and moto.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import psutil
import yaml

from generator.dataset.layout import natural_shard_size
from generator.scenario.shipped import find_scenario
from generator.speed.load import cores

REQUEST = re.compile(r'"(GET|PUT|POST|HEAD|DELETE) ([^ "]*)')
COMMAND = "import sys; from benchmark.cli.app import main; sys.argv[0] = 'skybench'; main()"
MAKE_BUCKET = "import fsspec; fsspec.filesystem('s3').mkdir('skies')"
MEASURE = "import fsspec; print(fsspec.filesystem('s3').du('skies'))"


def scenario_of(frames: int, folder: Path) -> Path:
    """The scene `00_hello` at random places and times, with a number of frames."""
    tree = yaml.safe_load(find_scenario("00_hello").read_text(encoding="utf-8"))
    tree |= {"name": "scaling", "frames": frames}
    tree["time"]["utc_start"] = {"utc": ["2020-01-01T00:00:00Z", "2021-01-01T00:00:00Z"], "sun_below_deg": -18}
    tree["site"] |= {"latitude_deg": {"uniform": [-60, 60]}, "longitude_deg": {"uniform": [-180, 180]}}
    path = folder / "scaling.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def start(scenario: Path, out: str, shards: str, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    arguments = ["generate", str(scenario), "--out", out, "--workers", "1", "--shards", shards, "--json"]
    return subprocess.Popen([sys.executable, "-c", COMMAND, *arguments], stdout=subprocess.DEVNULL, env=environment)


@dataclass(frozen=True)
class Timed:
    """Seconds from the start of the jobs to the end of the last one, and processor time including their workers."""

    seconds: float
    processor_s: float


def timed(scenario: Path, out: str, parts: tuple[str, ...], environment: dict[str, str]) -> Timed:
    """Run a job for each part of the shards, all in parallel."""
    before, began = processor_s(), time.monotonic()
    jobs = [start(scenario, out, part, environment) for part in parts]
    for job in jobs:
        if job.wait():
            raise SystemExit("a job failed")
    return Timed(time.monotonic() - began, processor_s() - before)


def processor_s() -> float:
    """Processor time of the child processes that this process has waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def store_s(server: subprocess.Popen[bytes]) -> float:
    """Processor time of the store."""
    used = psutil.Process(server.pid).cpu_times()
    return float(used.user + used.system)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--frames", type=int, default=200, help="of the dataset; a turn makes half of it, and all of it"
    )
    parser.add_argument("--turns", type=int, default=3)
    arguments = parser.parse_args()
    half, port = arguments.frames // 2, free_port()
    count = -(-arguments.frames // natural_shard_size(arguments.frames))
    if count % 2:
        raise SystemExit(f"--frames {arguments.frames}: {count} shards are no two halves")
    # A first, untimed job compiles the modules.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | {
        "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "FSSPEC_S3_ENDPOINT_URL": f"http://127.0.0.1:{port}",
    }  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="skybench-") as scratch:
        log = Path(scratch) / "requests.log"
        scenario = scenario_of(arguments.frames, Path(scratch))
        with log.open("wb") as stream:
            server = subprocess.Popen(
                [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
                stdout=subprocess.DEVNULL, stderr=stream,
            )  # fmt: skip
            try:
                wait_for(port)
                subprocess.run([sys.executable, "-c", MAKE_BUCKET], check=True, env=environment)
                ratios: dict[str, list[float]] = {"store": [], "folder": [], "most": []}
                parts = f"0:{count // 2}", f"{count // 2}:{count}"
                timed(scenario, f"{scratch}/skies/first", ("0:1",), environment)
                for turn in range(arguments.turns):
                    for place, root in (("store", "s3://skies"), ("folder", str(Path(scratch) / "skies"))):
                        served = store_s(server)
                        one = timed(scenario, f"{root}/one-{turn}", parts[:1], environment)
                        between = store_s(server)
                        two = timed(scenario, f"{root}/two-{turn}", parts, environment)
                        used = between - served, store_s(server) - between
                        ratios[place].append(2 * one.seconds / two.seconds)
                        print(
                            f"{place}: one job {half / one.seconds:.2f} frames/s, two jobs {2 * half / two.seconds:.2f}: "
                            f"{ratios[place][-1]:.2f}; processor time of the jobs {one.processor_s:.1f} and "
                            f"{two.processor_s:.1f} s, of the store {used[0]:.1f} and {used[1]:.1f} s",
                            flush=True,
                        )
                        if place == "store":
                            # Two jobs cannot end before the cores have done the work of both and of the store.
                            soonest = (two.processor_s + used[1]) / cores()
                            ratios["most"].append(2 * one.seconds / soonest)
                size = subprocess.run([sys.executable, "-c", MEASURE], check=True, env=environment, capture_output=True)
            finally:
                server.kill()
                server.wait()
        frames = 3 * half * arguments.turns
        requests = Counter(
            method for method, path in REQUEST.findall(log.read_text(errors="replace")) if "skies" in path
        )
        shards = 3 * (count // 2) * arguments.turns
        median = {name: statistics.median(values) for name, values in ratios.items()}
        print(f"two jobs over one: store {median['store']:.2f}, local folder {median['folder']:.2f} (medians)")
        print(f"with the store's work on the same {cores()} cores, two jobs can reach {median['most']:.2f} of one")
        print(
            f"{int(size.stdout) / frames / 1e6:.2f} MB a frame; requests a shard of {arguments.frames // count} frames:"
        )
        for method, number in sorted(requests.items()):
            print(f"  {method} {number / shards:.1f}")
        print("load averages:", *(f"{load:.1f}" for load in os.getloadavg()))


def wait_for(port: int) -> None:
    for _ in range(300):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise SystemExit("moto's server does not answer")


if __name__ == "__main__":
    main()
