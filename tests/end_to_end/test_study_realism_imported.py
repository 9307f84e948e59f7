"""`skybench study realism` with a folder of photographs: what is left out, and the same attitude on both sides."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from astropy.io import fits
from typer.testing import CliRunner

import celnav
from benchmark.cli.app import app
from benchmark.studies.realism import imported_pairs
from benchmark.twin.sources import sources_of
from generator.frame.render import render_frame
from generator.scenario.file import parse_scenario

SCENE = {
    "name": "clearing",
    "site": {"latitude_deg": 30.0, "longitude_deg": 10.0, "height_m": 500.0},
    "time": {"utc_start": "2020-01-24T19:30:00Z", "exposure_s": 30.0},
    "camera": {"model": "equidistant", "width": 480, "height": 400, "f_px": 120.0, "image_circle_px": 185.0,
               "aperture_mm": 1.0, "psf_sigma_px": 0.8},
    "sensor": {"bits": 16, "gain_e_per_dn": 0.5, "black_level_dn": 500, "full_well_e": 30000.0, "read_noise_e": 4.0},
    "attitude": {"azimuth_deg": 180.0, "altitude_deg": 90.0, "roll_deg": 0.0},
    "sky": {"components": ["airglow", "zodiacal", "milky_way", "starlight"]},
}  # fmt: skip
STARTS = ("2020-01-25T19:10:00Z", "2020-01-25T20:10:00Z", "2020-01-25T21:10:00Z", "2020-01-25T22:10:00Z")
TILT_DEG = 0.1
"""Tilt of the mount, of which solvers receive only the size."""


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three photographs of a night, and one at noise that shows no star; the folder is named as a task is."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "clearing.yaml").write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    (folder / "photos").mkdir()
    for number, start in enumerate(STARTS):
        night = {
            "time": {"utc_start": start, "exposure_s": 30.0},
            "attitude": {"azimuth_deg": 180.0, "altitude_deg": 90.0 - TILT_DEG, "roll_deg": 0.0},
            "seed": number,
        }
        dn = render_frame(parse_scenario(yaml.safe_dump(SCENE | night), "night.yaml"), 0, channels=False).dn
        if number == 3:
            dn = np.random.default_rng(1).normal(900.0, 20.0, dn.shape).astype(np.uint16)
        image = fits.PrimaryHDU(dn)
        image.header.update({"DATE-OBS": start.removesuffix("Z"), "EXPTIME": 30.0})
        image.writeto(folder / "photos" / f"night-{number}.fits")
    mount = parse_scenario(yaml.safe_dump(SCENE), "scene.yaml").frame(0).R_cam
    told = {
        "camera": celnav.Camera("equidistant", 480, 400, f_px=120.0).to_dict(),
        "attitude": {"R_cam": mount.tolist(), "tilt_sigma_deg": TILT_DEG, "heading_sigma_deg": TILT_DEG},
    }
    (folder / "camera.json").write_text(json.dumps(told), encoding="utf-8")
    command = f"import photos {folder}/photos --site 30 10 500 --camera {folder}/camera.json --out {folder}/meteor-real"
    run = CliRunner().invoke(app, command.split())
    assert run.exit_code == 0, run.output
    return folder


@pytest.mark.journey
def test_a_folder_s_photographs_are_compared_with_their_twins(
    photographs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(photographs)
    command = (
        "study realism meteor-real --scene clearing.yaml --solver skybench --solver tetra3rs --out out --work work"
    )
    run = CliRunner().invoke(app, command.split())
    assert run.exit_code == 0, run.output
    study = json.loads((photographs / "out/study.json").read_text(encoding="utf-8"))
    assert study["photographs"] == ["night-0", "night-1", "night-2"]
    assert study["left_out"] == ["night-3"]
    assert study["calibrated_on"] is None
    rows = pq.read_table(photographs / "out/outcomes.parquet").to_pandas()
    ours = rows[rows.solver == "skybench"]
    # The mount's tilt is an error of 11 km on photographs and twins alike.
    assert ours.real_error_km.to_numpy() == pytest.approx(111.2 * TILT_DEG, rel=0.1)
    assert ours.twin_error_km.to_numpy() == pytest.approx(ours.real_error_km.to_numpy(), rel=0.15)
    assert "night-3" in (photographs / "out/index.html").read_text(encoding="utf-8")
    # What is there is used again.
    made = (photographs / "work/frames/frame-00000.png").stat().st_mtime_ns
    again = CliRunner().invoke(app, command.split())
    assert again.exit_code == 0, again.output
    assert (photographs / "work/frames/frame-00000.png").stat().st_mtime_ns == made
    # Twins of which solvers would receive another camera than of the photographs are not.
    aligned = sources_of([photographs / "meteor-real"])[:3]
    assert imported_pairs._kept(photographs / "work", aligned) is not None
    assert aligned[0].imported is not None
    aligned[0].imported.record["told"]["tilt_sigma_deg"] = 2 * TILT_DEG
    assert imported_pairs._kept(photographs / "work", aligned) is None
