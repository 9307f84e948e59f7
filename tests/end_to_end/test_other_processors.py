"""Frames are the same bytes on a processor of another kind, which QEMU emulates."""

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
from generator.light.bake_grids import BakedAir
from generator.light.disk_scattering import disk_single
from generator.light.single_scattering import city_single
from generator.light.view_directions import view_directions
from generator.scenario.file import load_scenario
import numpy as np  # after generator, which settles its instructions

def digest(column):
    values = column.to_numpy()
    return hashlib.sha256(values.tobytes() if values.dtype != object else repr(values.tolist()).encode()).hexdigest()

def digest_array(values):
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()

frame = render_frame(load_scenario(Path(sys.argv[1])), 0)
hashes = {"image": pixels_sha256(frame.dn), "electrons": pixels_sha256(frame.expected.electrons)}
views, nm = view_directions(np.array([10.0, 70.0]), np.array([0.0, 90.0])), np.array([450.0, 650.0])
hashes["lamps"] = digest_array(city_single(BakedAir(), nm, 0.1, np.array([[0.0, 12.0], [3.0, 5.0]]), views))
hashes["city"] = digest_array(disk_single(BakedAir(), nm, 0.1, 0.0, 10.0, views))
print(json.dumps(hashes | {name: digest(frame.stars[name]) for name in frame.stars.column_names}))
"""
SCENE: dict[str, Any] = {
    "time__utc_start": "2020-02-05T20:00:00Z",
    "sky__bortle": None,
    "sky__cities": [],
    "sky__clouds": {"mean_optical_depth": 0.7, "coverage": 0.6, "altitude_km": 6},
    "camera": FISHEYE_CAMERA | {"width": 200, "height": 200, "f_px": 60.0, "bloom": {"share": 0.2}},
    "motion__rate_deg_s": [2.0, 1.0, 0.5],
}
"""A turning fisheye under a Moon, behind clouds. A city's light takes an emulator minutes: a few directions of it do."""


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
def test_a_frame_is_the_same_bytes_on_another_processor(tmp_path) -> None:
    """As Intel's of 2013 has AVX2 but no AVX-512. QEMU 7.2 sorts wrongly by AVX2, so that hot pixels are beyond it."""
    scenario = tmp_path / "scene.yaml"
    scenario.write_text(small_scenario_text(**SCENE))
    assert rendered(scenario, "Haswell", tmp_path / "there") == rendered(scenario, None, tmp_path / "here")
