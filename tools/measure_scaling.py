"""Two jobs of one dataset in an object store, against one: python tools/measure_scaling.py --frames 200 --turns 3.

Each turn runs one job that makes the first half of the shards, then two jobs at the same time that make a half each
(`skybench generate --shards`, one process a job), whole processes with their start. Printed: frames a second, the ratio of
the two rates turn by turn, and the requests and bytes that the store saw. The store is moto's server on this machine, which
has its share of the processor time. Needs the extra `cluster` of pyproject.toml, and moto.
"""

from __future__ import annotations

import argparse
import os
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import yaml

from generator.dataset.layout import natural_shard_size
from generator.scenario.shipped import find_scenario

REQUEST = re.compile(r'"(GET|PUT|POST|HEAD|DELETE) ([^ "]*)')
COMMAND = "import sys; from benchmark.cli.app import main; sys.argv[0] = 'skybench'; main()"
MAKE_BUCKET = "import fsspec; fsspec.filesystem('s3').mkdir('skies')"
MEASURE = "import fsspec; print(fsspec.filesystem('s3').du('skies'))"


def scenario_of(frames: int, folder: Path) -> Path:
    """The scene `00_hello` at places and times by chance, so many times."""
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


def timed(jobs: list[subprocess.Popen[bytes]], began: float) -> float:
    for job in jobs:
        if job.wait():
            raise SystemExit("a job failed")
    return time.monotonic() - began


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
    environment = os.environ | {
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
                ratios = []
                for turn in range(arguments.turns):
                    began = time.monotonic()
                    one_s = timed([start(scenario, f"s3://skies/one-{turn}", f"0:{count // 2}", environment)], began)
                    began = time.monotonic()
                    out = f"s3://skies/two-{turn}"
                    parts = f"0:{count // 2}", f"{count // 2}:{count}"
                    two_s = timed([start(scenario, out, part, environment) for part in parts], began)
                    ratios.append(2 * one_s / two_s)
                    print(
                        f"one job {half / one_s:.2f} frames/s, two jobs {2 * half / two_s:.2f}: {ratios[-1]:.2f}",
                        flush=True,
                    )
                size = subprocess.run([sys.executable, "-c", MEASURE], check=True, env=environment, capture_output=True)
            finally:
                server.kill()
                server.wait()
        frames = 3 * half * arguments.turns
        requests = Counter(
            method for method, path in REQUEST.findall(log.read_text(errors="replace")) if "skies" in path
        )
        shards = 3 * (count // 2) * arguments.turns
        print(f"two jobs over one: median {statistics.median(ratios):.2f}")
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
