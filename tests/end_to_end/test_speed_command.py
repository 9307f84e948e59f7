"""`skybench speed` on tiny frames and few inputs: the shape of what it answers. No test asserts a time."""

import json
import os
import re
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

import celnav
from benchmark.cli.app import app
from benchmark.fields import solver_effort, solver_table
from benchmark.fields.hostile import ATTITUDES, CAMERAS, KINDS, make_hostile
from generator.sensor.detector import defect_pixels, effects
from generator.speed import load as speed_load
from generator.speed import report as speed_report
from generator.speed.pairs import PairedTimes
from generator.speed.scenes import FrameSize, data_set, everything

TINY = FrameSize(width=48, height=32, limiting_magnitude=3.0)


@pytest.fixture(scope="module")
def tiny_report() -> speed_report.SpeedReport:
    return speed_report.measure(frames=1, pairs=1, size=TINY)


# What is measured starts three processes that render.
@pytest.mark.journey
def test_json_has_stages_floor_rates_and_ratios(tiny_report, monkeypatch) -> None:
    asked = {}

    def measure(frames, pairs, codec, progress):
        asked.update(frames=frames, pairs=pairs, codec=codec)
        return tiny_report

    monkeypatch.setattr(speed_report, "measure", measure)
    run = CliRunner().invoke(app, ["speed", "--json", "--frames", "1", "--pairs", "1"])
    assert run.exit_code == 0, run.output
    assert asked == {"frames": 1, "pairs": 1, "codec": "png"}
    answer = json.loads(run.stdout)
    assert answer["format"] == "skybench-speed/1"
    assert answer["frame"] == {"width": 48, "height": 32, "limiting_magnitude": 3.0}
    assert list(answer["stages_s"]) == ["plan", "render", "of which sky maps", "noise", "truth", "image", "parquet"]
    assert list(answer["floor_s"]) == ["poisson", "normals", "png"]
    assert list(answer["frames_per_s"]) == ["1", "2"]
    parts = [*answer["stages_s"].values(), *answer["floor_s"].values(), *answer["frames_per_s"].values()]
    assert all(value > 0 for value in parts)
    assert answer["frame_s"] == pytest.approx(
        sum(answer["stages_s"].values()) - answer["stages_s"]["of which sky maps"]
    )
    assert answer["over_floor"] == pytest.approx(answer["frame_s"] / sum(answer["floor_s"].values()))
    assert answer["scaling"] == pytest.approx(answer["frames_per_s"]["2"] / answer["frames_per_s"]["1"])
    for ratio in (answer["sky"], answer["camera"], answer["everything"]):
        assert ratio["ratio"] == pytest.approx(ratio["full_s"][0] / ratio["plain_s"][0])
    assert answer["load"]["cores"] >= 1
    assert answer["load"]["core_share"] > 0
    assert answer["device"]
    assert answer["variant"] in ("llvm_ad_spectral", "cuda_ad_spectral")


# As above.
@pytest.mark.journey
def test_tables_are_printed_for_people(tiny_report, monkeypatch) -> None:
    monkeypatch.setattr(speed_report, "measure", lambda *args, **values: tiny_report)
    run = CliRunner().invoke(app, ["speed"])
    assert run.exit_code == 0
    for words in ("frame over floor", "scaling", "median ratio", "everything", "load average"):
        assert words in run.stdout
    kept = CliRunner().invoke(app, ["speed", "--limit", "everything=1e9", "--limit", "floor=1e9"])
    assert kept.exit_code == 0
    broken = CliRunner().invoke(app, ["speed", "--limit", "sky=1e9", "--limit", "camera=1e-9", "--json"])
    assert broken.exit_code == 1
    assert "camera: " in broken.stderr
    assert "sky" not in broken.stderr
    assert json.loads(broken.stdout)["limits"] == {"sky": 1e9, "camera": 1e-9}


def test_ratio_is_the_median_over_pairs() -> None:
    assert PairedTimes((1.0, 2.0, 4.0), (2.0, 6.0, 4.0)).ratio == 2.0


def test_full_camera_is_the_one_of_the_bar() -> None:
    spec = data_set(FrameSize(), 1, full_camera=True).frame(0)
    assert (spec.camera.width, spec.camera.height) == (1080, 720)
    assert spec.sensor.colour is not None
    assert spec.sensor.colour.pattern == "RGGB"
    assert spec.sensor.rolling_shutter is not None
    assert spec.motion.samples == 32
    assert not spec.motion.still
    assert spec.camera.psf is not None
    assert spec.camera.psf.varies
    assert set(spec.sky.active_components) >= {"airglow", "zodiacal", "milky_way", "skyglow", "moonlight", "twilight"}


@pytest.mark.parametrize("text", ["floor", "floor=", "floor=0", "floor=nan", "frames=2", "=2"])
def test_what_is_no_limit_is_refused(text) -> None:
    run = CliRunner().invoke(app, ["speed", "--limit", text])
    assert run.exit_code == 2
    assert "floor=2" in run.stderr.replace("\n", " ")


def test_everything_is_on_in_the_set_of_that_name() -> None:
    plain, spec = (kind(FrameSize(), 2).frame(0) for kind in (data_set, everything))
    assert (spec.camera.width, spec.camera.height) == (plain.camera.width, plain.camera.height)
    assert spec.stars.limiting_magnitude == plain.stars.limiting_magnitude
    full = data_set(FrameSize(), 1, full_camera=True).frame(0)
    assert spec.camera == full.camera
    assert spec.camera.strays
    assert spec.motion == full.motion
    assert spec.sensor.rolling_shutter == full.sensor.rolling_shutter
    assert {type(effect).__name__ for effect in effects(spec.sensor)} == {
        "Converter", "CosmicRays", "DarkCurrent", "FixedLines", "FixedOffset", "FullWell", "Interference", "LineNoise",
        "PhotoResponse", "PhotonNoise", "ReadNoise", "TelegraphNoise",
    }  # fmt: skip
    assert len(defect_pixels(spec.sensor)) == 2
    assert spec.sensor.blooming
    assert spec.sky.clouds is not None
    assert set(spec.sky.active_components) == set(plain.sky.active_components)
    assert spec.foreground.landscape is not None
    assert spec.foreground.lamps
    assert spec.stars.scintillation


def test_the_load_of_the_machine_is_known() -> None:
    assert 1 <= speed_load.cores() <= (os.cpu_count() or 1)
    assert speed_load.load_average() >= 0
    import drjit

    with speed_load.one_thread():
        before = drjit.thread_count()
    assert before == 1
    clock = speed_load.best_clock()
    start = clock()
    assert clock() >= start


def test_a_gpu_s_own_name_is_given(monkeypatch, tmp_path) -> None:
    """The CPU twin of a run on a GPU: the name comes from the driver's tool, the rest of the path is the same."""
    tool = tmp_path / "nvidia-smi"
    tool.write_text("#!/bin/sh\necho 'NVIDIA H100 80GB HBM3'\necho 'NVIDIA T4'\n", encoding="utf-8")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert speed_report.device_name("cuda_ad_spectral") == "NVIDIA H100 80GB HBM3"
    tool.unlink()
    assert speed_report.device_name("cuda_ad_spectral") == "GPU of unknown name"
    assert speed_report.device_name("llvm_ad_spectral")


def test_unknown_codec_is_refused() -> None:
    run = CliRunner().invoke(app, ["speed", "--codec", "gif"])
    assert run.exit_code != 0
    assert "gif" in run.output


def test_hostile_inputs_are_made_from_seed_and_number_alone() -> None:
    inputs = [make_hostile(3, number) for number in range(70)]
    assert {each.kind for each in inputs} == set(KINDS)
    assert {each.camera_name for each in inputs} == set(CAMERAS)
    assert {each.attitude_name for each in inputs} == set(ATTITUDES)
    assert {each.flux is None for each in inputs} == {True, False}
    again = make_hostile(3, 41)
    assert again.name == inputs[41].name
    assert (again.uv == inputs[41].uv).all()
    assert max(len(each.uv) for each in inputs) > 10_000


def test_effort_report_holds_work_against_its_bound() -> None:
    solver = celnav.SkybenchSolver(celnav.SkybenchConfig(max_work=1_000_000))
    report = solver_effort.measure_effort(len(KINDS), 5, solver)
    assert len(report.refusals) == len(KINDS)
    assert 0 < report.most_work.work <= report.max_work == 1_000_000
    assert report.claims == 0
    text = "\n".join(report.lines())
    for kind in KINDS:
        assert re.search(rf"^\| {kind} \| 1 \| 0\.\d\d \| [\d.]+ \| [\d.]+ \| [\d.]+ \|$", text, re.MULTILINE), text
    assert f"calibration loop: {report.loop_s:.4f} s" in text
    assert report.slowest.question.name in text
    document = report.document()
    assert (document["inputs"], document["claims"]) == (len(KINDS), 0)
    assert sum(report.reasons.values()) == len(KINDS)


def test_speed_of_the_solver_prints_both_tables_and_fails_where_one_does(monkeypatch) -> None:
    asked = []

    def table(fields, seed, echo):
        asked.append((fields, seed))
        echo("bars")
        return (solver_table.Row("easy", ">= 99 %", {"solved": 1.0}, ("100 %", "0 of 2", "1.0"), True),)

    def effort(n_inputs, seed, echo):
        asked.append((n_inputs, seed))
        echo("hostile")
        return SimpleNamespace(passed=n_inputs < 9, document=lambda: {"inputs": n_inputs})

    monkeypatch.setattr(solver_table, "solver_speed", table)
    monkeypatch.setattr(solver_effort, "report_effort", effort)
    run = CliRunner().invoke(app, ["speed", "--solver", "--fields", "2", "--hostile", "8", "--seed", "4"])
    assert (run.exit_code, run.stdout.split()) == (0, ["bars", "hostile"])
    assert asked == [(2, 4), (8, 4)]
    assert CliRunner().invoke(app, ["speed", "--solver", "--hostile", "9"]).exit_code == 1
    as_json = CliRunner().invoke(app, ["speed", "--solver", "--hostile", "8", "--json"])
    answer = json.loads(as_json.stdout)
    assert answer["effort"] == {"inputs": 8}
    assert (answer["rows"][0]["values"], answer["rows"][0]["reached"]) == ({"solved": 1.0}, True)


def test_rows_of_the_table_say_whether_their_bar_is_reached() -> None:
    row = solver_table.Row("hard", ">= 99 %", {"solved": 0.5}, ("50 %", "0 of 2", "1.0"), False)
    assert row.line() == "| hard | >= 99 % | 50 % | 0 of 2 | 1.0 | NO |"
