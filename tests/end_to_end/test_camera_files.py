"""Photographs and stacks of video frames in datasets: whole, read back, the same alone; a position from a photograph."""

import io
import json

import numpy as np
import pytest
import yaml
from astropy.io import fits
from small_scenes import BASE
from typer.testing import CliRunner

from benchmark.cli.app import app
from celnav.__main__ import main as celnav
from generator.dataset.reader import Dataset
from generator.frame.render import render_frame
from generator.scenario.file import load_scenario

LENS = {"camera": {"width": 720, "height": 480, "f_px": 700, "pixel_pitch_um": 5, "aperture_mm": 5}}
PHOTO = LENS | {
    "attitude": {"azimuth_deg": 120, "altitude_deg": 60},
    "time": {"utc_start": "2020-01-15T20:00:00.25Z", "exposure_s": 4},
    "sensor": {"colour": {}, "gain_e_per_dn": 2, "develop": {"exposure": "auto", "photo": {"utc_offset": "+01:00"}}},
}
VIDEO = {
    "time": {"utc_start": "2020-01-15T20:00:00Z", "exposure_s": 0.4},
    "sensor": {"gain_e_per_dn": 2, "video": {"keep": True}},
}


@pytest.mark.journey
@pytest.mark.parametrize(("name", "parts"), [("photo", PHOTO), ("video", VIDEO)])
def test_files_of_a_camera_are_in_a_dataset(name, parts, tmp_path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(yaml.safe_dump(BASE | parts | {"frames": 2}), encoding="utf-8")
    made = CliRunner().invoke(app, ["generate", str(scene), "--out", str(tmp_path / "set")])
    assert made.exit_code == 0, made.output
    checked = CliRunner().invoke(app, ["verify", str(tmp_path / "set")])
    assert checked.exit_code == 0, checked.output
    frames = list(Dataset.open(tmp_path / "set"))
    alone = render_frame(load_scenario(scene), 1)
    assert {suffix: frames[1].members[suffix] for suffix in alone.attached} == alone.attached
    if name == "photo":
        assert frames[1].photo.shape == (480, 720, 3)
        assert frames[1].record["sensor"]["photo"]["utc_offset"] == "+01:00"
    else:
        with fits.open(io.BytesIO(frames[1].members["stack.fits"])) as stored:
            np.testing.assert_array_equal(stored["AVEPIXEL"].data, frames[1].image)
        assert frames[1].record["sensor"]["video"]["frames"] == 10


def test_a_position_from_a_rendered_photograph(tmp_path, capsys) -> None:
    """Time and camera from the file's tags, pixels after demosaicing, sRGB and JPEG: within 1 km of the place."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(yaml.safe_dump(BASE | PHOTO), encoding="utf-8")
    path = tmp_path / "photo.jpg"
    path.write_bytes(render_frame(load_scenario(scene), 0).attached["photo.jpg"])
    assert celnav(["solve", str(path), "--attitude", "azimuth=120,altitude=60,roll=0", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["lat_deg"] == pytest.approx(52.0, abs=0.009)
    assert answer["lon_deg"] == pytest.approx(4.36, abs=0.0146)
