"""`skybench plan`: what would be made, how many frames, how long, how large."""

import json
from pathlib import Path

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
        " on ",
        "guess",
        "MB",
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


def test_a_bad_scenario_is_one_line_and_exit_2(path) -> None:
    path.write_text(path.read_text().replace("bortle", "bortel"))
    result = CliRunner().invoke(app, ["plan", str(path)])
    assert result.exit_code == 2
    assert "sky.bortel: unknown key; did you mean 'bortle'?" in result.output


def test_times_and_sizes_for_people() -> None:
    assert [duration(value) for value in (0.42, 42, 600, 9000, 1e6)] == ["0.42 s", "42 s", "10 min", "2.5 h", "12 d"]
    assert [file_size(value) for value in (640e3, 1.24e9, 3e13)] == ["640 kB", "1.2 GB", "30 TB"]
