"""The calibration study of any camera: its projections, its predictions, its words, and what it refuses at once."""

import dataclasses
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import BenchmarkError
from benchmark.studies.calibration import run as run
from benchmark.studies.calibration import study as study
from benchmark.studies.calibration.camera_by_gradient import STARTING_PX, gradient_scenario, starting_sigma
from benchmark.studies.calibration.chosen import (
    check_gradient,
    check_sizes,
    notes_of,
    read_sizes,
    subject_of,
)
from benchmark.studies.calibration.faults import (
    WHOLE_SKY,
    check_stars,
    chosen_faults,
    declared_truth,
    make_study_frame,
    solver_camera,
)
from benchmark.studies.calibration.lens import derivatives, field_deg, project, with_k1
from benchmark.studies.common.centroid_frames import list_stars
from generator.scenario.file import parse_scenario
from generator.scenario.projection import MODELS, Projection

SCENARIO = Path(__file__).parents[3] / "scenes" / "calibration_study.yaml"
CAMERA = "  width: 1080\n  height: 720\n  hfov_deg: 120\n"
FISHEYE = "  model: equidistant\n  width: 800\n  height: 600\n  hfov_deg: 180\n"
LONG = "  model: brown_conrady\n  width: 960\n  height: 640\n  f_px: 6864\n  k: [-0.4]\n"
BY_MM = "  width: 640\n  height: 512\n  focal_length_mm: 6\n  pixel_pitch_um: 5.5\n"
STEREOGRAPHIC = "  model: stereographic\n  width: 640\n  height: 512\n  hfov_deg: 100\n"


def scenario_of(camera=CAMERA, **changes):
    text = SCENARIO.read_text(encoding="utf-8").replace(CAMERA, camera)
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    return parse_scenario(text, "mine.yaml")


def lens_of(model):
    k = {"brown_conrady": (-0.1, 0.02), "kannala_brandt": (0.01, -0.002)}.get(model, ())
    p = (1e-3, -5e-4) if model == "brown_conrady" else ()
    return Projection(model, 400.0, 420.0, 330.0, 250.0, k, p)


@pytest.mark.parametrize("model", MODELS)
def test_projections_are_those_that_celnav_reads_from_the_same_numbers(model):
    lens = lens_of(model)
    angles = np.random.default_rng(np.random.SeedSequence(3)).uniform([0.0, 0.0], [0.9, 2 * np.pi], (50, 2))
    theta, turn = angles.T
    rays = np.column_stack((np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)))
    camera = solver_camera(lens, 640, 512)
    np.testing.assert_allclose(project(rays, lens), camera.project(rays), atol=1e-8)
    _, by_direction = camera.project_with_derivatives(rays)
    np.testing.assert_allclose(derivatives(rays, lens), by_direction, atol=1e-3)
    assert np.isnan(project(np.array([[0.0, 0.6, -0.8]]), lens)).all() == (
        model in ("pinhole", "brown_conrady", "orthographic")
    )


def test_fields_and_first_coefficients():
    assert field_deg(Projection("equidistant", 800 / np.pi, 800 / np.pi, 399.5, 299.5), 800) == pytest.approx(
        180.0, abs=0.1
    )
    assert field_deg(Projection("pinhole", 320.0, 320.0, 319.5, 255.5), 640) == pytest.approx(90.0, abs=0.1)
    assert with_k1(lens_of("pinhole"), 0.1).k == (0.1,)
    assert with_k1(lens_of("brown_conrady"), 0.1).k == (0.0, 0.02)
    assert with_k1(lens_of("equidistant"), 0.1).model == "kannala_brandt"
    assert with_k1(lens_of("stereographic"), 0.1) is None


@pytest.mark.parametrize(("camera", "words"), [
    (FISHEYE, "equidistant, 800 x 600 px, 180 degrees across"),
    (LONG, "Brown-Conrady, 960 x 640 px, 8.02 degrees across"),
    (BY_MM, "pinhole, 640 x 512 px, 32.7 degrees across"),
], ids=["fisheye", "long", "by mm"])  # fmt: skip
def test_the_solver_of_any_camera_shifts_as_predicted(camera, words):
    scenario = scenario_of(camera, stars=("limiting_magnitude: 6.5", "limiting_magnitude: 8.5"))
    subject = subject_of(scenario)
    assert (subject.text, subject.tilt_text) == (words, "is tilted by 20 degrees")
    stars = list_stars(run.changed_scenario(scenario, "sky", 1, camera=WHOLE_SKY), 0)
    names = (run.DECLARED, run.CALIBRATED, run.THESIS_FIX)
    for fault in chosen_faults(subject, {}):
        if fault.key in ("projection", "k1"):
            continue
        frame = make_study_frame(stars, subject.camera, fault.setting(fault.typical))
        assert len(frame.uv) > 20
        right = {name: run.offset_km(frame, name, declared_truth(frame)) for name in names}
        for found in run.shifts_of(run.CENTROIDS, fault, fault.typical, frame, names, right):
            if found.contestant == run.CALIBRATED and fault.key == "focal":
                assert found.moved_km < 0.1
            elif found.contestant == run.DECLARED or fault.key == "clock":
                assert found.along == pytest.approx(1.0, abs=0.1), (fault.key, found.contestant)


def test_the_whole_sky_is_listed_wherever_the_camera_looks():
    stars = list_stars(run.changed_scenario(scenario_of(LONG), "sky", 1, camera=WHOLE_SKY), 0)
    enu = stars.rays @ np.asarray(stars.plan.spec.R_cam)
    assert {tuple(sign) for sign in np.sign(enu[enu[:, 2] > 0.3][:, :2]).astype(int).tolist()} >= {(1, 1), (-1, -1)}


@pytest.mark.parametrize(("option", "words"), [
    ("foo=1", "no such fault; write FAULT=SIZE,SIZE with one of focal (%), centre (px), k1"),
    ("focal", "'' is not a list of numbers"),
    ("focal=a", "'a' is not a list of numbers"),
    ("focal=0", "between more than 0 and 30 %"),
    ("focal=nan", "between more than 0 and 30 %"),
    ("focal=31", "between more than 0 and 30 %"),
    ("projection=170", "between 1 and 150 deg"),
    ("refraction=-1", "between 0 and 60 deg"),
])  # fmt: skip
def test_sizes_that_cannot_be_are_refused(option, words):
    with pytest.raises(BenchmarkError) as error:
        read_sizes([option])
    assert str(error.value).startswith(f"--sizes {option}: ")
    assert words in str(error.value)


def test_sizes_are_read_and_one_of_them_is_typical():
    sizes = read_sizes(["focal=3,0.5,1", "refraction=0,20", "tilt=0.1,5"])
    assert sizes == {"focal": (0.5, 1.0, 3.0), "refraction": (0.0, 20.0), "tilt": (0.1, 5.0)}
    faults = {fault.key: fault for fault in chosen_faults(subject_of(scenario_of()), sizes)}
    assert (faults["focal"].sizes, faults["focal"].typical) == ((0.5, 1.0, 3.0), 1.0)
    assert faults["tilt"].typical == 0.1
    assert faults["clock"].sizes == (0.1, 1.0, 10.0, 100.0)
    with pytest.raises(BenchmarkError, match="has sizes already"):
        read_sizes(["focal=1", "focal=2"])


REFUSED = {
    "sweep": (
        scenario_of,
        {"camera": CAMERA.replace("120", "{sweep: [50, 60]}")},
        r"camera\.hfov_deg: the study takes no sweeps",
    ),
    "draw": (scenario_of, {"camera": CAMERA.replace("120", "{uniform: [50, 60]}")}, r"camera\.hfov_deg: the study is of one"),
    "down": (
        scenario_of,
        {"camera": LONG, "look": ("altitude_deg: 70", "altitude_deg: -30")},
        r"attitude\.altitude_deg: the camera sees no sky",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_scenarios_that_cannot_be_studied_are_refused(name):
    make, changes, words = REFUSED[name]
    with pytest.raises(BenchmarkError, match=rf"^mine\.yaml: {words}"):
        subject_of(make(**changes))


def test_what_a_camera_cannot_have_is_refused_with_the_way_around_it():
    scenario = scenario_of(STEREOGRAPHIC)
    subject = subject_of(scenario)
    with pytest.raises(BenchmarkError, match=r"^mine\.yaml: camera\.model: stereographic has no k1 .* --gradient 0"):
        check_gradient(scenario, subject)
    with pytest.raises(BenchmarkError, match="no k1; leave this option out"):
        check_sizes(subject, {"k1": (0.1,)})
    assert "k1" not in {fault.key for fault in chosen_faults(subject, {})}
    colour = dataclasses.replace(subject_of(scenario_of()), is_colour=True)
    with pytest.raises(BenchmarkError, match=r"sensor\.colour: .* --gradient 0"):
        check_gradient(scenario, colour)
    dark = scenario_of(LONG, stars=("limiting_magnitude: 6.5", "limiting_magnitude: 2.0"))
    lists = [list_stars(run.changed_scenario(dark, "sky", 1, camera=WHOLE_SKY), 0)]
    with pytest.raises(BenchmarkError, match=r"^mine\.yaml: stars\.limiting_magnitude: half of the frames hold"):
        check_stars(dark, subject_of(dark).camera, lists)


def test_the_gradient_takes_the_camera_of_the_scenario_in_a_model_with_k1():
    for camera, model in ((FISHEYE, "kannala_brandt"), (BY_MM, "brown_conrady"), (LONG, "brown_conrady")):
        scenario = scenario_of(camera)
        subject = subject_of(scenario)
        made = gradient_scenario(scenario, subject.camera, 2).frame(0).camera
        assert (made.model, made.width, made.height) == (model, subject.camera.width, subject.camera.height)
        assert made.f_px == pytest.approx(subject.camera.f_px)
        sigma = starting_sigma(made)
        assert sigma[2] * made.f_px == pytest.approx(STARTING_PX)
        moved = project(np.array([[0.0, 0.0, 1.0]]), made.projection)
        assert np.isfinite(moved).all()


def test_notes_state_numbers_of_the_camera():
    subject = subject_of(scenario_of())
    note = notes_of(subject, chosen_faults(subject, {"k1": (0.001,)}))["k1"]
    # A corner at r = 649 px of a pinhole with f = 311.8 px moves by 0.001 r^3/f^2.
    assert note == "Stars in the corner move by 2.8 px at 0.001."
    assert run.thesis_edge_px(subject.camera) == pytest.approx(180.0)


def test_the_command_on_the_page_can_be_pasted(tmp_path, monkeypatch):
    asked = []

    def record(path, sizes, work, out, command, progress, fault_sizes):
        asked.append((path, sizes, fault_sizes, command))
        raise BenchmarkError("enough")

    monkeypatch.setattr(study, "run_study", record)
    mine = tmp_path / "my scene.yaml"
    mine.write_text(SCENARIO.read_text(encoding="utf-8").replace(CAMERA, FISHEYE), encoding="utf-8")
    words = ["skybench", "study", "calibration", "--scenario", str(mine), "--sites", "3", "--sizes", "focal=0.5,1"]
    for _ in range(2):
        CliRunner().invoke(app, words[1:])
        words = shlex.split(asked[-1][-1])
    assert asked[0] == asked[1]
    assert asked[0][0] == mine
    assert asked[0][2] == {"focal": (0.5, 1.0)}
    CliRunner().invoke(app, ["study", "calibration"])
    assert asked[-1][-1] == "skybench study calibration"


def test_refusals_come_before_anything_is_made(tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text(SCENARIO.read_text(encoding="utf-8").replace(CAMERA, STEREOGRAPHIC), encoding="utf-8")
    out = tmp_path / "out"
    outcome = CliRunner().invoke(
        app, ["study", "calibration", "--scenario", str(mine), "--out", str(out), "--work", str(out)]
    )
    assert outcome.exit_code == 2
    assert outcome.output.startswith(f"skybench: {mine}: camera.model: stereographic has no k1")
    assert not out.exists()
