"""`skybench plan`: what would be made, how many frames, how long, how large."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from small_scenes import BASE
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.report.formatting import duration, file_size
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.scenario.file import load_scenario

TREE = BASE | {
    "name": "planned",
    "frames": 2,
    "site": {"latitude_deg": {"uniform": [-60, 60]}, "longitude_deg": 4.0},
    "camera": {"width": 96, "height": 64, "hfov_deg": 100, "aperture_mm": 4},
    "sensor": {"quantum_efficiency": "qe.csv"},
    "sky": {"bortle": {"sweep": [2, 5, 8]}},
}


@pytest.fixture
def path(tmp_path) -> Path:
    (tmp_path / "qe.csv").write_text("wavelength_nm,quantum_efficiency\n400,0.5\n700,0.6\n")
    (tmp_path / "planned.yaml").write_text(yaml.safe_dump(TREE))
    return tmp_path / "planned.yaml"


def test_it_says_what_would_be_made(path) -> None:
    printed = CliRunner().invoke(app, ["plan", str(path)], env={"COLUMNS": "140"}).output
    for phrase in (
        "planned",
        "6 (3 combinations x 2)",
        "sweep sky.bortle",
        "2, 5, 8",
        "draw site.latitude_deg",
        "{uniform: [-60, 60]}",
        "qe.csv",
        "96 x 64, 12 bits",
        "100 x ",
        " e per pixel: ",
        "with SNR >= 5",
        "Sun, Moon",
        " with `generate` on ",
        "from the first frame",
        "expected electrons (EXR)",
        "B as 16-bit PNG",
        load_scenario(path).sha256,
    ):
        assert phrase in printed


def test_measured_size_is_that_of_the_dataset(path, tmp_path) -> None:
    """Within 30 % of images, records and tables of the whole set, whose frames differ."""
    result = CliRunner().invoke(app, ["plan", str(path), "--measure", "--json"])
    expected = json.loads(result.output)
    assert (expected["frames"], expected["measured"], expected["files"].keys()) == (6, True, {"qe.csv"})
    assert expected["sweeps"] == {"sky.bortle": [2, 5, 8]}
    assert expected["seconds"] > 0
    generate(load_scenario(path), path.read_text(), tmp_path / "set", DatasetSpec(shard_size=1))
    kept = [file for kind in ("data", "stars", "objects") for file in (tmp_path / "set" / kind).rglob("shard-*")]
    assert expected["bytes"] == pytest.approx(sum(file.stat().st_size for file in kept), rel=0.3)


def test_a_distribution_inside_a_list_is_shown_as_written() -> None:
    printed = CliRunner().invoke(app, ["plan", "scenes/clutter.yaml"], env={"COLUMNS": "140"})
    assert printed.exit_code == 0, printed.output
    assert "draw foreground.trails.0.v_mag" in printed.output
    assert "{uniform: [1, 4]}" in printed.output


def test_numbers_of_the_first_frame_are_those_of_its_files(path) -> None:
    from generator.frame.render import render_frame

    first = json.loads(CliRunner().invoke(app, ["plan", str(path), "--json"]).output)["first"]
    frame = render_frame(load_scenario(path), 0)
    stars = frame.stars.to_pandas()
    stars = stars[stars["fraction_in_frame"] > 0]
    assert first["visible_stars"] == int(((stars["snr"] >= 5) & (stars["fraction_in_frame"] >= 0.5)).sum()) > 0
    assert first["saturated_stars"] == int(stars["saturated"].sum())
    assert first["sky_e"] == pytest.approx(float(np.median(frame.expected.sky_electrons)))
    assert first["sun_altitude_deg"] == pytest.approx(frame.plan.sky.sun_altitude_deg)


SHORT = BASE["time"] | {"exposure_s": 0.01}


def planned_warnings(tmp_path, **changes) -> list[str]:
    tree = BASE | {"camera": {"width": 96, "height": 64, "hfov_deg": 100, "aperture_mm": 4}, "time": SHORT}
    (tmp_path / "slip.yaml").write_text(yaml.safe_dump(tree | changes))
    result = CliRunner().invoke(app, ["plan", str(tmp_path / "slip.yaml"), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.output)["warnings"]


ISS_2008 = {
    "line1": "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
    "line2": "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537",
    "v_mag": -3,
}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"sensor": {"gain_e_per_dn": 0.27}},
            "sensor.gain_e_per_dn: 0.27 ends the 12-bit converter's range at 1.09e+03",
        ),
        ({"sensor": {"gain_e_per_dn": 0.27}}, "it looks like DN per electron; 3.7 electrons per DN would fit"),
        ({"sensor": {"full_well_e": 100000}}, "24.8 electrons per DN would use the whole range"),
        (
            {"camera": {"width": 96, "height": 64, "focal_length_mm": 4, "pixel_pitch_um": 50, "aperture_mm": 5}},
            "camera.aperture_mm: 5 is wider than the focal length (4 mm): f/0.8",
        ),
        (
            {"site": BASE["site"] | {"height_m": 4000}, "atmosphere": {"pressure_hpa": 1010}},
            "atmosphere.pressure_hpa: 1010 contradicts the site's height",
        ),
        ({"sky": {"bortle": 8, "components": ["airglow"]}}, "sky.bortle: makes no sky brighter that has no 'skyglow'"),
        ({"foreground": {"satellites": [ISS_2008]}}, "foreground.satellites.0: its elements are more than 14 days"),
        ({"time": BASE["time"] | {"exposure_s": 100}}, "of the pixels saturate"),
    ],
)
def test_slips_are_warned_of(tmp_path, changes, said) -> None:
    assert any(said in warning for warning in planned_warnings(tmp_path, **changes))


def test_sound_values_are_not_warned_of(tmp_path) -> None:
    assert planned_warnings(tmp_path) == []
    assert planned_warnings(tmp_path, site=BASE["site"] | {"height_m": 4000}) == []


@pytest.mark.journey
@pytest.mark.parametrize("command", ["render", "generate"])
def test_frames_of_a_contradiction_are_made_with_a_warning(tmp_path, command) -> None:
    tree = BASE | {"camera": {"width": 32, "height": 24, "hfov_deg": 100, "aperture_mm": 4}, "time": SHORT}
    place = {"height_m": {"sweep": [0, 4000, 5000]}}
    (tmp_path / "slip.yaml").write_text(
        yaml.safe_dump(tree | {"site": BASE["site"] | place, "atmosphere": {"pressure_hpa": 1010}})
    )
    result = CliRunner().invoke(app, [command, str(tmp_path / "slip.yaml"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "frame 1: atmosphere.pressure_hpa: 1010 contradicts the site's height of 4000 m" in said
    assert "and 1 more of this kind" in said


def test_a_bad_scenario_is_one_line_and_exit_2(path) -> None:
    path.write_text(path.read_text().replace("bortle", "bortel"))
    result = CliRunner().invoke(app, ["plan", str(path)])
    assert result.exit_code == 2
    assert "sky.bortel: unknown key; did you mean 'bortle'?" in result.output


def test_times_and_sizes_for_people() -> None:
    assert [duration(value) for value in (0.42, 42, 600, 9000, 1e6)] == ["0.42 s", "42 s", "10 min", "2.5 h", "12 d"]
    assert [file_size(value) for value in (640e3, 1.24e9, 3e13)] == ["640 kB", "1.2 GB", "30 TB"]
