"""Frames are the same bytes on processors of other makers and years, which QEMU emulates."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from small_scenes import FISHEYE_CAMERA, small_scenario_text

from generator.instruction_set import NUMPY_VARIABLES, OPENBLAS_VARIABLE, UNSETTLED_VARIABLE

EMULATOR = shutil.which("qemu-x86_64")
PROGRAM = """
import hashlib, json, sys
from pathlib import Path
from generator.frame.render import render_frame
from generator.identity.pixels import pixels_sha256
from generator.scenario.file import load_scenario

def digest(column):
    values = column.to_numpy()
    return hashlib.sha256(values.tobytes() if values.dtype != object else repr(values.tolist()).encode()).hexdigest()

frame = render_frame(load_scenario(Path(sys.argv[1])), 0)
hashes = {"image": pixels_sha256(frame.dn), "electrons": pixels_sha256(frame.expected.electrons)}
print(json.dumps(hashes | {name: digest(frame.stars[name]) for name in frame.stars.column_names}))
"""
SCENES: dict[str, dict[str, Any]] = {
    "clouds under a Moon": {
        "time__utc_start": "2020-02-05T20:00:00Z",
        "sky__clouds": {"mean_optical_depth": 0.7, "coverage": 0.6, "altitude_km": 6},
    },
    "a fisheye that turns": {
        "camera": FISHEYE_CAMERA | {"width": 300, "height": 300, "f_px": 90.0, "bloom": {"share": 0.2}},
        "motion__rate_deg_s": [2.0, 1.0, 0.5],
    },
}


def rendered(scenario: Path, processor: str | None, home: Path) -> dict[str, str]:
    """Hashes of a frame's image, expected electrons and truth, from a process that finds no kernels of others."""
    settled = {OPENBLAS_VARIABLE, UNSETTLED_VARIABLE, *NUMPY_VARIABLES}
    environment = {name: value for name, value in os.environ.items() if name not in settled}
    command = [sys.executable, "-c", PROGRAM, str(scenario)]
    if processor is not None:
        assert EMULATOR is not None
        command = [EMULATOR, "-cpu", processor, *command]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env=environment | {"HOME": str(home)}, timeout=500
    )
    return dict(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.journey
@pytest.mark.skipif(EMULATOR is None, reason="no emulator of processors: apt install qemu-user")
@pytest.mark.parametrize("name", SCENES)
def test_a_frame_is_the_same_bytes_on_other_processors(name, tmp_path) -> None:
    scenario = tmp_path / "scene.yaml"
    scenario.write_text(small_scenario_text(**SCENES[name]))
    here = rendered(scenario, None, tmp_path / "here")
    for processor in ("Haswell", "EPYC-Milan"):
        assert rendered(scenario, processor, tmp_path / processor) == here, processor
