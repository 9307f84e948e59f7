"""`skybench twin`: the twin of a photograph that skybench itself rendered in a known weather is that photograph."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from astropy.io import fits
from PIL import Image
from typer.testing import CliRunner

import celnav
from benchmark.cli.app import app
from generator.frame.render import render_frame
from generator.frame.verify import problems
from generator.scenario.file import load_scenario, parse_scenario

SCENE = {
    "name": "clearing",
    "site": {"latitude_deg": 30.0, "longitude_deg": 10.0, "height_m": 500.0},
    "time": {"utc_start": "2020-01-24T19:30:00Z", "exposure_s": 30.0},
    "camera": {
        "model": "equidistant",
        "width": 480,
        "height": 400,
        "f_px": 120.0,
        "image_circle_px": 185.0,
        "aperture_mm": 1.0,
        "psf_sigma_px": 0.8,
    },
    "sensor": {"bits": 16, "gain_e_per_dn": 0.5, "black_level_dn": 500, "full_well_e": 30000.0, "read_noise_e": 4.0},
    "attitude": {"azimuth_deg": 180.0, "altitude_deg": 90.0, "roll_deg": 0.0},
    "sky": {"components": ["airglow", "zodiacal", "milky_way", "starlight"]},
}
OTHER_NIGHT = {
    "time": {"utc_start": "2020-01-25T21:10:00Z", "exposure_s": 30.0},
    "attitude": {"azimuth_deg": 180.0, "altitude_deg": 89.6, "roll_deg": 0.3},
    "atmosphere": {"aerosol_tau_550": 0.2},
    "sky": SCENE["sky"] | {"airglow_factor": 1.6},
    "seed": 9,
}


def write_fits(path: Path, dn: np.ndarray, start: str) -> Path:
    """An image with the header of a fixed camera."""
    image = fits.PrimaryHDU(dn)
    place = {"OBSLAT": 30.0, "OBSLONG": 10.0, "OBSALT": 500.0}
    image.header.update({"DATE-OBS": start.removesuffix("Z"), "EXPTIME": 30.0} | place)
    image.writeto(path)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, and a photograph of another night by another attitude."""
    folder = tmp_path_factory.mktemp("twin")
    (folder / "clearing.yaml").write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    night = parse_scenario(yaml.safe_dump(SCENE | OTHER_NIGHT), str(folder / "night.yaml"))
    write_fits(folder / "night.fits", render_frame(night, 0, channels=False).dn, OTHER_NIGHT["time"]["utc_start"])
    return folder


@pytest.mark.journey
def test_the_twin_has_the_weather_and_the_stars_of_its_photograph(folder: Path) -> None:
    arguments = ["twin", str(folder / "night.fits"), "--scene", str(folder / "clearing.yaml")]
    run = CliRunner().invoke(app, [*arguments, "--out", str(folder / "out"), "--json"])
    assert run.exit_code == 0, run.output
    (twin,) = json.loads(run.stdout)["twins"]
    assert twin["alignment"]["stars"] > 60
    assert twin["alignment"]["turned_deg"] == pytest.approx(0.5, abs=0.02)
    assert twin["weather"]["airglow_factor"] == pytest.approx(1.6, rel=0.06)
    assert twin["weather"]["aerosol_tau_550"] == pytest.approx(0.2, abs=0.04)
    assert twin["weather"]["cloud_tau"] is None
    assert twin["sky_ratio"] == pytest.approx(np.ones(6), abs=0.04)
    assert twin["snr_ratio"] == pytest.approx(1, abs=0.06)
    assert twin["flux_ratio"] == pytest.approx(1, abs=0.04)
    assert twin["noise_ratio"] == pytest.approx(1, abs=0.05)
    for detector in ("sep", "celnav"):
        assert twin["detections"][detector]["ratio"] == pytest.approx(1, abs=0.12)
    stored = json.loads((folder / "out/twins.json").read_text(encoding="utf-8"))
    assert stored["twins"] == [twin]
    assert "| night |" in (folder / "out/twins.md").read_text(encoding="utf-8")
    with Image.open(folder / "out/night.jpg") as picture:
        assert picture.width == 1240
    scenario = load_scenario(folder / "out/twin-night.yaml")
    assert scenario.frame(0).time.utc_start == "2020-01-25T21:10:00Z"
    assert problems(folder / "out/frames") == []


@pytest.mark.journey
def test_the_twin_of_an_imported_photograph_is_a_frame_with_truth(folder: Path, tmp_path: Path) -> None:
    """The scene has another lens, place and attitude, which the records replace."""
    camera = celnav.Camera("equidistant", 480, 400, f_px=120.0)
    R_cam = parse_scenario(yaml.safe_dump(SCENE | OTHER_NIGHT), "night.yaml").frame(0).R_cam
    attitude = {"R_cam": R_cam.tolist(), "tilt_sigma_deg": 0.05, "heading_sigma_deg": 0.05}
    calibrated = {"camera": camera.to_dict(), "attitude": attitude}
    (tmp_path / "camera.json").write_text(json.dumps(calibrated), encoding="utf-8")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/night.fits").write_bytes((folder / "night.fits").read_bytes())
    other = SCENE | {
        "site": {"latitude_deg": -20.0, "longitude_deg": 99.0, "height_m": 0.0},
        "camera": SCENE["camera"] | {"width": 400, "f_px": 110.0, "image_circle_px": 185.0 * 110.0 / 120.0},
        "attitude": {"azimuth_deg": 10.0, "altitude_deg": 70.0},
    }
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(other), encoding="utf-8")
    chain = (
        f"import photos {tmp_path}/photos --site 30 10 500 --camera {tmp_path}/camera.json --out {tmp_path}/set",
        f"twin {tmp_path}/set --scene {tmp_path}/other.yaml --out {tmp_path}/out --json",
        f"verify {tmp_path}/out/frames",
        f"show {tmp_path}/out/frames",
        f"bench run {tmp_path}/out/frames --solver skybench --out {tmp_path}/results --json",
    )
    outputs = []
    for command in chain:
        run = CliRunner().invoke(app, command.split())
        assert run.exit_code == 0, (command, run.output)
        outputs.append(run.stdout)
    (twin,) = json.loads(outputs[1])["twins"]
    assert twin["weather"]["airglow_factor"] == pytest.approx(1.6, rel=0.06)
    assert twin["sky_ratio"] == pytest.approx(np.ones(6), abs=0.04)
    assert twin["flux_ratio"] == pytest.approx(1, abs=0.04)
    record = json.loads((tmp_path / "out/frames/frame-00000.json").read_text(encoding="utf-8"))
    assert record["camera"]["f_px"] == 120.0
    assert record["site"]["latitude_deg"] == 30.0
    assert np.array(record["attitude"]["R_cam"]) == pytest.approx(R_cam, abs=5e-4)
    assert record["stars"]["n_in_field"] > 100
    summary = json.loads(outputs[4])["runs"][0]["summary"]
    assert (summary["n_frames"], summary["n_fixes"]) == (1, 1)


def test_the_ground_of_photographs_becomes_a_picture(folder: Path) -> None:
    target = folder / "ground.png"
    arguments = ["twin", str(folder / "night.fits"), "--scene", str(folder / "clearing.yaml")]
    run = CliRunner().invoke(app, [*arguments, "--ground", str(target)])
    assert run.exit_code == 0, run.output
    with Image.open(target) as picture:
        assert picture.mode == "RGBA"
        alpha = np.asarray(picture)[..., 3]
    v, u = np.indices(alpha.shape) - (alpha.shape[0] - 1) / 2
    assert alpha[np.hypot(u, v) < 0.8 * alpha.shape[0] / 2].mean() < 5


def test_what_cannot_be_used_is_refused_in_one_line(folder: Path, tmp_path: Path) -> None:
    small = write_fits(tmp_path / "small.fits", np.zeros((20, 30), np.uint16), "2020-01-25T21:10:00Z")
    cases = [
        ([str(small), "--scene", str(folder / "clearing.yaml")], "has 30 x 20 pixels"),
        ([str(tmp_path / "none.fits"), "--scene", str(folder / "clearing.yaml")], "cannot be read"),
        ([str(small), "--scene", "bortle"], "frames; a camera's scene has one"),
        (
            [str(small), "--scene", str(folder / "clearing.yaml"), "--passing", str(small)],
            "expected trails of a scenario's foreground",
        ),
    ]
    for arguments, words in cases:
        run = CliRunner().invoke(app, ["twin", *arguments, "--out", str(tmp_path / "out")])
        assert run.exit_code == 2
        assert words in " ".join(run.stderr.split())


@pytest.mark.slow  # a frame of 1.4 megapixels is rendered and fitted: a minute
@pytest.mark.parametrize("name", ["005", "008"])
def test_the_twin_of_a_photograph_of_a_clear_night(name: str, tmp_path: Path) -> None:
    """Two nights of a camera whose preset was measured on them: the sky within 10 % at all altitudes above 10 deg."""
    photographs = Path(__file__).parents[1] / "data" / "allsky"
    arguments = ["twin", str(photographs / f"{name}.fits.bz2"), "--scene", "observatory_allsky"]
    run = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path), "--json"])
    assert run.exit_code == 0, run.output
    (twin,) = json.loads(run.stdout)["twins"]
    assert twin["alignment"]["stars"] > 400
    assert twin["sky_ratio"] == pytest.approx(np.ones(6), abs=0.1)
    assert twin["noise_ratio"] == pytest.approx(1, abs=0.1)
    assert twin["snr_ratio"] == pytest.approx(1, abs=0.1)
    assert twin["flux_ratio"] == pytest.approx(1, abs=0.1)
    assert twin["detections"]["sep"]["ratio"] == pytest.approx(1, abs=0.15)
    assert twin["nearest_share_real"] / twin["nearest_share_twin"] == pytest.approx(1, abs=0.1)
