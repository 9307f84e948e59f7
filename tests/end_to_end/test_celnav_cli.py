"""``celnav solve`` as a user runs it."""

import importlib.util
import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from celnav.__main__ import main
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

ROOT = Path(__file__).parents[2]
SITE = ("2021-08-05T22:40:00Z", 46.5, 7.9)
# The same instant on a camera's clock, an exposure of 8 s, and the lens of 1080x720 pixels at 120 deg: 10.4 mm.
PHOTO = {0x9003: "2021:08:06 00:39:56", 0x829A: IFDRational(8), 0x920A: IFDRational(104, 10), 0xA405: 10}


@pytest.fixture(scope="module")
def sky():
    path = Path(__file__).parents[1] / "physics" / "celnav" / "independent_sky.py"
    spec = importlib.util.spec_from_file_location("independent_sky_for_cli", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def files(sky, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sky")
    frame = sky.make_frame(*SITE, 6.0, earth_orientation(parse_utc(SITE[0])))
    electrons = np.random.default_rng(1).poisson(sky.render(frame))
    deep = np.clip(electrons // 2 + 100, 0, 4095).astype(np.uint16)
    Image.fromarray(deep).save(folder / "deep.png")
    eight_bits = Image.fromarray(np.clip((deep - 100) / 2, 0, 255).astype(np.uint8))
    eight_bits.save(folder / "sky.jpg", quality=98)
    exif = Image.Exif()
    exif[0x0110] = "Sky 1"
    exif.get_ifd(0x8769).update(PHOTO)
    eight_bits.save(folder / "photo.jpg", quality=98, exif=exif.tobytes())
    Image.fromarray(np.full_like(deep, 200)).save(folder / "blank.png")
    eight_bits.save(folder / "sky.bmp")
    Image.fromarray(deep.T).save(folder / "upright.png")
    (folder / "cut.png").write_bytes((folder / "deep.png").read_bytes()[:5000])
    camera = {"model": "pinhole", "width": 1080, "height": 720, "f_px": sky.F_PX}
    (folder / "camera.json").write_text(json.dumps(camera))
    (folder / "small.json").write_text(json.dumps(camera | {"width": 640}))
    record = {"camera": camera, "attitude": {"R_cam": sky.ZENITH_NORTH_UP.tolist()}}
    (folder / "frame.json").write_text(json.dumps(record))
    return folder


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"celnav {version('skybench')}\n"


def arguments(files, image="deep.png", **changes):
    options = {"camera": files / "camera.json", "utc": SITE[0], "attitude": "zenith-north-up"} | changes
    return ["solve", str(files / image), *(str(x) for key, value in options.items() for x in (f"--{key}", value))]


@pytest.mark.parametrize("image", ["deep.png", "sky.jpg"])
@pytest.mark.parametrize("solver", ["thesis-adaptive", "thesis-baseline"])
def test_fix(sky, files, capsys, image, solver):
    assert main([*arguments(files, image, solver=solver), "--json"]) == 0
    fix = json.loads(capsys.readouterr().out)
    assert fix["ok"]
    assert fix["solver"] == solver
    assert fix["n_matches"] > 20
    assert sky.distance_km(SITE[1], SITE[2], fix["lat_deg"], fix["lon_deg"]) < 2.0


def test_frame_record_serves_as_camera_and_attitude(files, capsys):
    assert main(arguments(files, camera=files / "frame.json", attitude=files / "frame.json")) == 0
    text = capsys.readouterr().out
    assert "latitude    46." in text
    assert "longitude   7." in text


def test_a_reader_that_has_seen_enough_is_no_error(files):
    command = [sys.executable, "-m", "celnav", *arguments(files, "blank.png")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1


def test_refusal(files, capsys):
    assert main(arguments(files, "blank.png")) == 1
    assert "too_few_detections" in capsys.readouterr().out
    assert main([*arguments(files, "blank.png"), "--json"]) == 1
    fix = json.loads(capsys.readouterr().out)
    assert (fix["ok"], fix["lat_deg"], fix["reason"]) == (False, None, "too_few_detections")


def test_a_time_limit_ends_the_search(files, capsys):
    assert main([*arguments(files), "--time-limit-s", "1e-9"]) == 1
    assert "effort_spent" in capsys.readouterr().out
    assert main([*arguments(files), "--time-limit-s", "3600"]) == 0
    assert main([*arguments(files), "--time-limit-s", "-1"]) == 2
    assert "time_limit_s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("image", "changes", "text"),
    [
        ("none.png", {}, "does not exist"),
        ("cut.png", {}, "damaged"),
        ("camera.json", {}, "not a PNG"),
        ("sky.bmp", {}, "HEIF image: convert a picture of another format to PNG or TIFF"),
        ("deep.png", {"mask": "sky.bmp"}, "convert a picture of another format to PNG or TIFF"),
        ("deep.png", {"utc": "2020-01-01T00:00:00"}, "zone"),
        ("deep.png", {"camera": "small.json"}, "640 x 720"),
        ("deep.png", {"camera": "small.json"}, "calibrate again for cropped or binned ones, or give --camera unknown"),
        ("upright.png", {}, "the camera is 1080 x 720 pixels, but the image 720 x 1080: turn the picture back"),
        ("deep.png", {"camera": "none.json"}, "cannot read camera"),
        ("deep.png", {"attitude": "camera.json"}, "R_cam"),
        ("deep.png", {"attitude": "altitude=91"}, "between -90 and 90"),
        ("deep.png", {"attitude": "zenit"}, "zenith-north-up"),
        ("deep.png", {"plot": "found.jpg"}, ".png"),
        ("deep.png", {"plot": "nowhere/found.png"}, "folder does not exist"),
        ("deep.png", {"focal-length-mm": 8}, "--camera"),
        ("deep.png", {"solver": "ddr-dai", "calibrate": "full"}, "--calibrate"),
        ("raw.dng", {}, "16-bit TIFF"),
    ],
)
def test_bad_input_is_one_line_and_status_2(files, capsys, monkeypatch, image, changes, text):
    monkeypatch.chdir(files)
    assert main(arguments(files, image, **changes)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert text in captured.err


def found_of(capsys, *words):
    """Status and parsed output of the command with ``--json``."""
    status = main(["solve", *map(str, words), "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_a_photograph_says_time_and_lens_itself(sky, files, capsys):
    photo = files / "photo.jpg"
    status, found = found_of(capsys, photo, "--time-zone", "Europe/Zurich", "--attitude", "azimuth=180,altitude=90")
    assert status == 0
    assert found["utc"] == SITE[0]
    # The tags round the lens to 10 mm, and the solver finds the 4 % that it is off.
    assert found["camera"]["f_px"] == pytest.approx(10 / np.hypot(36, 24) * np.hypot(1080, 720))
    assert found["camera"]["f_px"] * np.exp(found["calibration"]["log_f"]["value"]) == pytest.approx(sky.F_PX, rel=1e-3)
    assert sky.distance_km(SITE[1], SITE[2], found["lat_deg"], found["lon_deg"]) < 2.0
    assert "Sky 1" in found["assumed"][0]
    assert "marks the start of 8 s" in " ".join(found["assumed"])
    assert "wide" in found["warnings"][0]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["photo.jpg"], "--time-zone"),
        (["sky.jpg", "--utc", SITE[0], "--sensor-width-mm", "36"], "--focal-length-mm"),
        (["sky.jpg", "--camera", "camera.json"], "--utc"),
    ],
)
def test_what_an_image_does_not_say_is_asked_for(files, capsys, monkeypatch, words, text):
    monkeypatch.chdir(files)
    assert main(["solve", *words]) == 2
    assert text in capsys.readouterr().err


def test_a_mirrored_picture_is_called_so(files, tmp_path, capsys):
    with Image.open(files / "deep.png") as image:
        turned = np.asarray(image)[::-1]
    Image.fromarray(turned).save(tmp_path / "turned.png")
    assert main(["solve", str(tmp_path / "turned.png"), *arguments(files)[2:]]) == 1
    assert "mirrored picture" in capsys.readouterr().out


def test_a_last_known_position_is_not_dropped_by_solvers_without_a_use_for_it(files, capsys):
    assert main([*arguments(files), "--solver", "thesis-baseline", "--near", "10,4.36,50"]) == 2
    assert "thesis-baseline has no use for a last known position" in capsys.readouterr().err


def test_stars_without_a_vertical_are_no_position(files, capsys):
    assert main(["solve", str(files / "deep.png"), "--camera", str(files / "camera.json"), "--utc", SITE[0]]) == 1
    text = capsys.readouterr().out
    assert "vertical_required" in text
    assert "--attitude altitude=45,roll=0, or --attitude zenith" in " ".join(text.split())
    assert "right ascension" in text


def test_json_is_a_page_and_matches_are_for_the_asking(files, capsys):
    words = [*arguments(files)[1:], "--matches"]
    assert main([*arguments(files), "--json"]) == 0
    assert len(capsys.readouterr().out.splitlines()) < 60
    status, found = found_of(capsys, *words)
    assert status == 0
    assert len(found["matches"]) == found["n_matches"] > 20
    assert {"u_px", "v_px", "star_id", "name"} <= set(found["matches"][0])
    assert "Vega" in {match["name"] for match in found["matches"]}
    assert main(["solve", *words]) == 0
    assert len(capsys.readouterr().out.splitlines()) > found["n_matches"]


def test_pointing_is_said_beside_the_matrix(files, capsys):
    _, found = found_of(capsys, *arguments(files, attitude="altitude=90,roll=0")[1:])
    turned = found["pointing"]
    # The heading that the stars tell; at the zenith only the difference of azimuth and roll has a meaning.
    assert turned["altitude_deg"] == pytest.approx(90, abs=1e-4)
    assert (turned["azimuth_deg"] - turned["roll_deg"]) % 360 == pytest.approx(180, abs=0.01)
    np.testing.assert_allclose(found["R_cam"], np.diag([-1.0, -1.0, 1.0]), atol=2e-4)


def test_the_time_is_that_of_the_whole_command(files, capsys):
    _, found = found_of(capsys, *arguments(files)[1:])
    stages = [ms for stage, ms in found["time_ms"].items() if stage != "total"]
    assert set(found["time_ms"]) == {"start", "reading", "detection", "solving", "total"}
    assert found["time_ms"]["total"] >= 0.999 * sum(stages)
    assert set(found["solver_time_ms"]) == {"prepare", "identify", "fix", "total"}
    assert found["solver_time_ms"]["total"] < found["time_ms"]["total"]


def test_a_picture_of_what_was_found(files, tmp_path, capsys):
    picture = tmp_path / "found.png"
    assert main([*arguments(files), "--plot", str(picture)]) == 0
    with Image.open(picture) as drawn:
        pixels = np.asarray(drawn.convert("RGB")).astype(int)
    assert pixels.shape[1] > 1000
    blue = (pixels[..., 2] > 150) & (pixels[..., 0] < 100)
    orange = (pixels[..., 0] > 150) & (pixels[..., 2] < 100)
    assert blue.sum() > 5000
    assert orange.sum() > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["found.png"]
    assert main([*arguments(files, "blank.png"), "--plot", str(picture)]) == 1
    capsys.readouterr()


def test_a_field_below_the_solver_s_limit_is_named(files, capsys):
    narrow = files / "narrow.json"
    narrow.write_text(json.dumps({"width": 1080, "height": 720, "hfov_deg": 4.0}))
    assert main(arguments(files, "blank.png", camera=narrow)) == 1
    assert "narrower than 5 deg" in capsys.readouterr().out
    assert main(arguments(files, "blank.png", camera=narrow, solver="ddr-dai")) == 1
    assert "ddr-dai ends" in capsys.readouterr().out


def test_as_a_module(files):
    """As a process: help has examples; bad input leaves no traceback."""
    shown = subprocess.run(
        [sys.executable, "-m", "celnav", "solve", "--help"], capture_output=True, text=True, check=True
    )
    assert "examples:" in shown.stdout
    failed = subprocess.run(
        [sys.executable, "-m", "celnav", *arguments(files, "cut.png")], capture_output=True, text=True, check=False
    )
    assert failed.returncode == 2
    assert "Traceback" not in failed.stderr


def test_import_is_quick_and_light():
    """Importing celnav loads neither scipy's heavy parts, nor Pillow, nor what the walls keep out."""
    code = (
        "import sys, celnav; heavy = {'mitsuba', 'generator', 'benchmark', 'astropy', 'pandas', 'PIL', 'scipy'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"
