"""`skybench twin` of a meteor camera's stacks: a stack that skybench rendered under another sky, with another gain."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from astropy.io import fits
from PIL import Image
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import PhotographError
from benchmark.photographed.view import not_sky_of
from benchmark.place import Place
from benchmark.twin.photograph import read_photograph
from benchmark.twin.stacked_video import read_stack, start_of
from benchmark.twin.video_twin import black_level
from celnav.camera import Camera
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.render import render_frame
from generator.scenario.file import load_scenario, parse_scenario

SCENE = {
    "name": "station",
    "site": {"latitude_deg": 52.0, "longitude_deg": -1.0, "height_m": 80.0},
    "time": {"utc_start": "2023-04-21T23:00:00Z", "exposure_s": 1.28},
    "camera": {
        "width": 480, "height": 320, "f_px": 330.0, "aperture_mm": 4.0, "psf_sigma_px": 0.9,
        "bloom": {"share": 0}, "veiling_glare": 0,
    },
    "sensor": {
        "bits": 12, "gain_e_per_dn": 0.05, "black_level_dn": 80, "full_well_e": 200.0, "read_noise_e": 1.0,
        "video": {"frames_per_s": 25.0, "codec": "none"},
    },
    "attitude": {"azimuth_deg": 180.0, "altitude_deg": 50.0, "roll_deg": 0.0},
    "sky": {"bortle": 4},
    "foreground": {"trails": [
        {"kind": "meteor", "start": {"azimuth_deg": 175, "altitude_deg": 55}, "end": {"azimuth_deg": 183, "altitude_deg": 46},
         "start_s": 0.3, "end_s": 0.7, "v_mag": -1},
    ]},
}  # fmt: skip
OTHER_NIGHT = {
    "time": {"utc_start": "2023-04-21T22:24:05.120Z", "exposure_s": 1.28},
    "attitude": {"azimuth_deg": 180.3, "altitude_deg": 49.9, "roll_deg": 0.2},
    "sensor": SCENE["sensor"] | {"gain_e_per_dn": 0.04},
    "sky": {"zenith_mag_arcsec2": 20.8},
    "foreground": {},
    "seed": 9,
}
NAME = "FF_XX0001_20230421_222405_120_0001234.fits.gz"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A station's scene, and a stack of another night under its file name."""
    folder = tmp_path_factory.mktemp("station")
    (folder / "station.yaml").write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    night = parse_scenario(yaml.safe_dump(SCENE | OTHER_NIGHT), str(folder / "night.yaml"))
    stack = render_frame(night, 0, channels=False).attached["stack.fits"]
    (folder / NAME).write_bytes(gzip.compress(stack))
    return folder


def test_the_twin_of_a_stack_has_its_sky_and_its_gain(folder: Path) -> None:
    """The zenith within 0.1 mag, the gain within 6 %: means of some hundred stars and of 8-bit light that is rounded down."""
    arguments = ["twin", str(folder / NAME), "--scene", str(folder / "station.yaml"), "--out", str(folder / "out")]
    run = CliRunner().invoke(app, [*arguments, "--json"])
    assert run.exit_code == 0, run.output
    (twin,) = json.loads(run.stdout)["twins"]
    assert twin["utc_start"] == "2023-04-21T22:24:05.120Z"
    assert twin["alignment"]["stars"] > 20
    assert twin["weather"]["zenith_mag_arcsec2"] == pytest.approx(20.8, abs=0.1)
    assert twin["weather"]["gain_factor"] == pytest.approx(1.25, rel=0.06)
    assert twin["noise_ratio"] == pytest.approx(1, abs=0.1)
    assert twin["flux_ratio"] == pytest.approx(1, abs=0.06)
    assert np.array(twin["sky_ratio"][3:5], float) == pytest.approx([1, 1], abs=0.06)
    real, made = twin["stack"]
    assert real["deviation_dn"] == pytest.approx(made["deviation_dn"], abs=1)
    tables = (folder / "out/twins.md").read_text(encoding="utf-8")
    assert "| zenith, mag | gain |" in tables
    assert "`STDPIXEL`" in tables
    spec = load_scenario(folder / "out" / f"twin-{twin['photograph']}.yaml").frame(0)
    assert spec.sky.zenith_mag_arcsec2 == pytest.approx(twin["weather"]["zenith_mag_arcsec2"], abs=1e-3)
    assert not spec.foreground.trails


def test_a_mask_leaves_out_what_is_black(folder: Path) -> None:
    picture = np.full((320, 480), 255, np.uint8)
    picture[200:] = 0
    Image.fromarray(picture).save(folder / "mask.png")
    camera = Camera("pinhole", 480, 320, f_px=330.0)
    hidden = not_sky_of(folder / "mask.png", camera)
    assert hidden[200:].all()
    assert not hidden[:200].any()
    (folder / "text.png").write_text("no picture", encoding="utf-8")
    with pytest.raises(PhotographError, match="cannot be read as a picture"):
        not_sky_of(folder / "text.png", camera)
    with pytest.raises(PhotographError, match="has 480 x 320 pixels, the camera 640 x 480"):
        not_sky_of(folder / "mask.png", Camera("pinhole", 640, 480, f_px=330.0))


def test_what_a_mask_hides_is_dark_ground_in_the_twin(folder: Path) -> None:
    """A reflectance of 0.3 that faces the camera from 27 deg up sees (1 - sin 27 deg) / 2 of the sky (Lambert's law)."""
    # Both together are too few pixels to measure the black level; the photograph is dark in the first alone.
    tree, bright = np.s_[290:310, 430:454], np.s_[296:300, 100:104]
    white = np.full((320, 480), 255, np.uint8)
    white[tree] = white[bright] = 0
    Image.fromarray(white).save(folder / "corner.png")
    (folder / "tree").mkdir()
    with fits.open(folder / NAME) as hdus:
        hdus["AVEPIXEL"].data[tree] = 6
        hdus.writeto(folder / "tree" / NAME)
    arguments = [
        "twin",
        str(folder / "tree" / NAME),
        "--scene",
        str(folder / "station.yaml"),
        "--out",
        str(folder / "masked"),
    ]
    run = CliRunner().invoke(app, [*arguments, "--mask", str(folder / "corner.png"), "--json"])
    assert run.exit_code == 0, run.output
    (twin,) = json.loads(run.stdout)["twins"]
    assert twin["weather"]["zenith_mag_arcsec2"] == pytest.approx(20.8, abs=0.1)
    scenario = load_scenario(folder / "masked" / f"twin-{twin['photograph']}.yaml")
    assert (folder / "masked" / f"twin-{twin['photograph']}-ground.png").is_file()
    expected = render_expected(plan_frame(scenario, 0), False, False)
    inside, outside = expected.electrons[294:306, 434:450], expected.electrons[294:306, 380:420]
    assert np.median(inside) / np.median(outside) == pytest.approx(0.3 * (1 - np.sin(np.radians(27))) / 2, rel=0.15)
    # The picture has 11 pixels per degree, the camera 6.
    assert expected.cover is not None
    covered = expected.cover > 0.5
    assert covered[tree].mean() > 0.9
    covered[tree] = False
    assert not covered[bright].any()
    assert covered.mean() < 0.001


def test_names_of_stacks_state_their_start() -> None:
    assert start_of("FF_UK0006_20230421_212224_982_0115712.fits") == "2023-04-21T21:22:24.982Z"
    assert start_of("FF_UK0006_20230421_212224_982_0115712.fits.bz2") == "2023-04-21T21:22:24.982Z"
    assert start_of("FF_UK0006_20231341_212224_982_0115712.fits") is None
    assert start_of("night.fits") is None


def test_files_that_are_no_stacks_are_refused(folder: Path) -> None:
    good = gzip.decompress((folder / NAME).read_bytes())
    assert read_stack(good, NAME).mean.shape == (320, 480)
    with pytest.raises(PhotographError, match="cannot be read as a stack of video"):
        read_stack(good[:5000], NAME)
    with pytest.raises(PhotographError, match="cannot be read as a stack of video"):
        read_stack(b"no FITS", NAME)
    path = folder / "other.fits"
    with fits.open(folder / NAME) as hdus:
        del hdus[0].header["FPS"]
        hdus.writeto(path)
    with pytest.raises(PhotographError, match="lacks NFRAMES and FPS"):
        read_stack(path.read_bytes(), NAME)
    with pytest.raises(PhotographError, match="says no place"):
        read_photograph(folder / NAME)
    assert read_photograph(folder / NAME, Place(1.0, 2.0, 3.0)).exposure_s == pytest.approx(1.28)


def test_stacks_and_scenes_must_fit(folder: Path) -> None:
    arguments = ["twin", str(folder / NAME), "--scene", "observatory_allsky", "--out", str(folder / "none")]
    run = CliRunner().invoke(app, arguments)
    assert run.exit_code == 2
    assert "a stack of video needs" in " ".join(run.stderr.split())


def test_dark_ground_tells_an_operators_setting_of_brightness() -> None:
    """Ground with 0.15 of the sky's light; 80 of 4095 DN are 5 of 255. Small differences leave the scene's."""
    rng = np.random.default_rng(6)
    hidden = np.zeros((100, 120), bool)
    hidden[80:, 40:70] = True
    light = np.where(hidden, rng.uniform(0.15, 0.9, hidden.shape), 1.0) * 22
    to_8_bit = 255 / 4095

    def found(black: float, mask: np.ndarray | None) -> int:
        return black_level(np.floor(black + light), ~hidden, mask, 80, to_8_bit)

    assert found(36.0, hidden) * to_8_bit == pytest.approx(36, abs=1)
    assert found(6.5, hidden) == 80
    assert found(36.0, None) == 80
    assert found(36.0, np.zeros_like(hidden)) == 80
