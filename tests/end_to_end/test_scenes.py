"""The scenarios in scenes/: each plans and renders its first frame, and gives the same bytes on any number of threads."""

import copy
import dataclasses
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from generator.frame.plan import plan_frame
from generator.frame.render import png_bytes, render_frame
from generator.scenario.file import Scenario, load_scenario
from generator.scenario.presets.camera_presets import PRESETS
from generator.scenario.variation import DISTRIBUTION_KEYS

ROOT = Path(__file__).parents[2]
SCENES = sorted((ROOT / "scenes").glob("*.yaml"))
REDUCTION = 6
LENGTHS_PX = ("f_px", "cx_px", "cy_px", "image_circle_px")
FEATURES = {
    "yale_projection", "thesis_mag", "bortle", "motion", "weather", "attitude", "calibration", "optics", "clutter", "horizon",
    "sensor", "00_hello", "stray_light", "sequence", "landscape", "hills", "meteor",
    "fixed_camera", "constellations",
}  # fmt: skip


def reduced(path: Path) -> Scenario:
    """The scenario with a sixth of the pixels along each side, the same field of view, and a second's exposure at most.

    A pixel that sees 36 times as much sky would be full after ten seconds.
    """
    scenario = load_scenario(path)
    template = copy.deepcopy(scenario.template)
    camera = template["camera"]
    preset = PRESETS[camera["preset"]].camera if "preset" in camera else {}
    for key in ("width", "height", *LENGTHS_PX):
        if key in preset:
            camera.setdefault(key, preset[key])
    if "focal_length_mm" in preset:
        camera["pixel_pitch_um"] = preset["pixel_pitch_um"] * REDUCTION
    for key in ("width", "height"):
        # Even, for the codec of a video.
        camera[key] = camera[key] // REDUCTION // 2 * 2
    if isinstance(template["time"].get("exposure_s"), float):
        template["time"]["exposure_s"] = min(template["time"]["exposure_s"], 1.0)
    for key in LENGTHS_PX:
        if key in camera:
            camera[key] /= REDUCTION
    return dataclasses.replace(scenario, template=template)


def test_every_feature_has_its_scene() -> None:
    assert {path.stem for path in SCENES} >= FEATURES
    for path in SCENES:
        lines = path.read_text().splitlines()
        assert lines[0].startswith("# "), path.name
        assert len(lines) <= 55, path.name


DAILY = ("00_hello", "night_with_everything", "sensor", "stray_light")
"""Scenes whose first frames the daily tests render; the others are rendered with the journeys."""


def test_documentation_lists_every_feature_way_to_vary_and_preset() -> None:
    text = (ROOT / "docs/scenarios.md").read_text()
    for word in (*(f"{name}.yaml" for name in FEATURES), *DISTRIBUTION_KEYS, "sweep", *PRESETS):
        assert word in text, word


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.journey] * (path.stem not in DAILY)) for path in SCENES],
    ids=lambda path: path.stem,
)
def test_scene_plans_and_renders_its_first_frame(path) -> None:
    scenario = reduced(path)
    plan = plan_frame(scenario, 0)
    assert len(plan.stars) > 100
    frame = render_frame(scenario, 0)
    assert frame.dn.shape == (plan.spec.camera.height, plan.spec.camera.width)
    assert frame.stars.num_rows > 50
    assert frame.dn.max() > frame.dn.min() + 20
    assert np.isfinite(frame.expected.electrons).all()


def test_projection_without_noise_puts_stars_and_nothing_else() -> None:
    """Between the stars no electron, and every star's light where the truth says."""
    frame = render_frame(reduced(ROOT / "scenes/yale_projection.yaml"), 0)
    stars = frame.stars.to_pandas()
    assert float(frame.expected.sky_electrons.max()) == 0
    assert (stars["airmass"] == 0).all()
    inside = stars[stars["fraction_in_frame"] > 0.999]
    v, u = np.mgrid[0 : frame.dn.shape[0], 0 : frame.dn.shape[1]]
    near = np.zeros(frame.dn.shape, dtype=bool)
    for star in stars.itertuples():
        near |= np.hypot(u - star.u_px, v - star.v_px) < 8
    assert frame.dn[~near].max(initial=0) == 0
    assert (inside[["start_u_px", "start_v_px"]].to_numpy() - inside[["end_u_px", "end_v_px"]].to_numpy()).max() < 0.01


def test_clutter_has_truth_rows_of_every_kind() -> None:
    frame = render_frame(reduced(ROOT / "scenes/clutter.yaml"), 0)
    assert frame.objects["kind"].to_pylist() == ["satellite", "satellite", "aircraft", "meteor", "satellite"]
    hidden = frame.stars.to_pandas().query("occluded")
    assert len(hidden) > 5
    assert hidden["electrons_e"].median() == 0


DIGEST = """
import hashlib, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from generator.mitsuba_runtime import set_threads
set_threads(int(sys.argv[2]))
from test_scenes import digests
print(*map(digests, map(Path, sys.argv[3:])), sep="\\n")
"""


def digests(path: Path) -> str:
    """Hashes of a scene's first frame: DN, expected electrons, truth."""
    frame = render_frame(reduced(path), 0)
    parts = [png_bytes(frame.dn), frame.expected.electrons.tobytes(), repr(frame.stars.to_pydict()).encode()]
    parts.append(repr(frame.objects.to_pydict()).encode())
    return " ".join(hashlib.sha256(part).hexdigest() for part in parts)


# The scenes with most of the camera and of its motion, and of the ground and what flies over it, in two more processes.
@pytest.mark.journey
def test_scenes_have_the_same_bytes_on_any_number_of_threads() -> None:
    """On one thread, on two, and in this process."""
    paths = [ROOT / f"scenes/{name}.yaml" for name in ("optics", "motion", "horizon", "clutter")]
    printed = [
        subprocess.run(
            [sys.executable, "-c", DIGEST, str(Path(__file__).parent), threads, *map(str, paths)],
            capture_output=True, text=True, check=True, cwd=ROOT, env=os.environ,
        ).stdout.splitlines()
        for threads in ("1", "2")
    ]  # fmt: skip
    assert printed[0] == printed[1] == [digests(path) for path in paths]
