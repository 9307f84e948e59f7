"""``celnav solve`` as a user runs it."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from celnav.cli import main
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

ROOT = Path(__file__).parents[2]
SITE = ("2021-08-05T22:40:00Z", 46.5, 7.9)


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
    Image.fromarray(np.clip((deep - 100) / 2, 0, 255).astype(np.uint8)).save(folder / "sky.jpg", quality=98)
    Image.fromarray(np.full_like(deep, 200)).save(folder / "blank.png")
    (folder / "cut.png").write_bytes((folder / "deep.png").read_bytes()[:5000])
    camera = {"model": "pinhole", "width": 1080, "height": 720, "f_px": sky.F_PX}
    (folder / "camera.json").write_text(json.dumps(camera))
    (folder / "small.json").write_text(json.dumps(camera | {"width": 640}))
    record = {"camera": camera, "attitude": {"R_cam": sky.ZENITH_NORTH_UP.tolist()}}
    (folder / "frame.json").write_text(json.dumps(record))
    return folder


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
    assert len(fix["matches"]) > 20
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
        ("deep.png", {"utc": "2020-01-01T00:00:00"}, "zone"),
        ("deep.png", {"camera": "small.json"}, "640 x 720"),
        ("deep.png", {"camera": "none.json"}, "cannot read camera"),
        ("deep.png", {"attitude": "camera.json"}, "R_cam"),
    ],
)
def test_bad_input_is_one_line_and_status_2(files, capsys, monkeypatch, image, changes, text):
    monkeypatch.chdir(files)
    assert main(arguments(files, image, **changes)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert text in captured.err


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
