"""`skybench import`: photographs become a dataset on which the other commands work."""

import json
from pathlib import Path

import numpy as np
import pytest
from photograph_files import standin, write_camera, write_ff, write_fits
from typer.testing import CliRunner

from benchmark.cli.app import app

SITE = ["--site", "52.0", "4.36", "10"]


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), (arguments, result.exception)
    return result.exit_code, result.output if result.exit_code else result.stdout


# A chain of five commands.
@pytest.mark.journey
def test_photographs_are_imported_verified_solved_reported_and_shown(tmp_path: Path) -> None:
    photos, camera = tmp_path / "photos", write_camera(tmp_path / "camera.json")
    photos.mkdir()
    write_fits(photos / "a.fits")
    write_fits(photos / "b.fits", standin(seed=2))
    out, results = tmp_path / "set", tmp_path / "results"
    code, text = run("import", "photos", photos, *SITE, "--camera", camera, "--out", out)
    assert code == 0, text
    assert "2 photographs" in text
    assert "px rms" in text
    code, text = run("import", "photos", photos, *SITE, "--camera", camera, "--out", out, "--json")
    assert json.loads(text)["made"] == []
    assert run("verify", out)[0] == 0
    code, text = run("bench", "run", out, "--solver", "skybench", "--out", results, "--json")
    summary = json.loads(text)["runs"][0]["summary"]
    assert (summary["n_frames"], summary["n_fixes"]) == (2, 2)
    assert summary["star_precision"]["value"] > 0.85  # of two stars on one pixel one is right
    assert run("bench", "report", "--out", results)[0] == 0
    assert (results / "site" / "index.html").is_file()
    assert run("show", out)[0] == 0
    assert "occluded" in (tmp_path / "set-show" / "frames" / "0.js").read_text()


def test_a_meteor_night_is_imported_and_refusals_say_what_to_do(tmp_path: Path) -> None:
    camera, night = write_camera(tmp_path / "camera.json"), tmp_path / "night"
    night.mkdir()
    code, text = run("import", "rms", night, "--camera", camera)
    assert (code, "no FF file" in text) == (2, True)
    mean = np.clip(standin("2020-01-15T20:00:00Z") // 4, 0, 255).astype(np.uint8)
    write_ff(night, "FF_XX0001_20200115_195954_880_0000000.fits", mean)
    code, text = run("import", "rms", night, "--camera", camera, "--out", tmp_path / "out")
    assert (code, "--site" in text) == (2, True)
    code, text = run("import", "rms", night, "--camera", camera, *SITE, "--out", tmp_path / "out")
    assert code == 0, text
    assert run("verify", tmp_path / "out")[0] == 0
