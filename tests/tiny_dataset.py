"""A scenario of twelve tiny frames, and what tests compare of datasets made of it."""

import hashlib
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

from small_scenes import BASE

from generator.dataset.layout import DatasetSpec

ROOT = Path(__file__).parents[1]
TINY = BASE | {
    "name": "tiny",
    "frames": 4,
    "site": {"latitude_deg": {"sphere_latitude": [-90, 90]}, "longitude_deg": {"uniform": [-180, 180]}},
    "time": {
        "utc_start": {"utc": ["2000-01-01T00:00:00Z", "2025-01-01T00:00:00Z"], "sun_below_deg": -6},
        "exposure_s": 0.5,
    },
    "camera": BASE["camera"] | {"width": 96, "height": 64},
    "sky": {"bortle": {"sweep": [2, 5, 8]}},
    "stars": {"limiting_magnitude": 6.0},
    "foreground": {
        "trails": [
            {
                "kind": "satellite",
                "start": {"azimuth_deg": 100, "altitude_deg": 70},
                "end": {"azimuth_deg": 120, "altitude_deg": 75},
                "v_mag": 1.0,
            }
        ]
    },
}
SPEC = DatasetSpec(shard_size=5, exr=True)


def fingerprint(folder: Path) -> dict[str, str]:
    """SHA-256 of every file but the logs, which hold times."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "logs" not in path.parts
    }


def members(folder: Path) -> dict[str, bytes]:
    """Everything in the archives of a dataset, by its name."""
    found = {}
    for path in sorted(folder.glob("data/*/*.tar")):
        with tarfile.open(path) as archive:
            found |= {member.name: archive.extractfile(member).read() for member in archive}
    return found


def start(*arguments: str, **options: Any) -> subprocess.Popen:
    """Start the command `skybench` with options of `Popen`."""
    code = "import sys; from benchmark.cli import main; sys.argv[0] = 'skybench'; main()"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-c", code, *arguments], cwd=ROOT, **pipes, **options)
