"""Files that the command's arguments name: pipes, devices and huge files are refused, whichever argument names them."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from celnav.__main__ import main
from celnav.command.camera_file import MAX_BYTES
from celnav.command.checks.input_files import LARGEST_IMAGE_BYTES, LARGEST_RECORD_BYTES

UTC = ["--utc", "2020-01-01T00:00:00Z"]
CAMERA = {"model": "pinhole", "width": 160, "height": 120, "f_px": 120.0}
ROW = [2458864.3, 10.0, 20.0, 100.0]


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("named")
    Image.fromarray(np.full((120, 160), 20, np.uint8)).save(folder / "image.png")
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    return str(folder / "image.png")


# What an argument is, the command with FILE in its place, and the largest file.
NAMED = {
    "image": (["solve", "FILE.png", *UTC], LARGEST_IMAGE_BYTES),
    "mask": (["solve", "IMAGE", "--mask", "FILE.png", *UTC], LARGEST_IMAGE_BYTES),
    "camera file": (["solve", "IMAGE", "--camera", "FILE.yml", *UTC], MAX_BYTES),
    "attitude file": (["solve", "IMAGE", "--camera", "CAMERA", "--attitude", "FILE.json", *UTC], MAX_BYTES),
    "image of a calibration": (["calibrate", "FILE.png", *UTC], LARGEST_IMAGE_BYTES),
    "frame record": (["calibrate", "FILE.png", *UTC], LARGEST_RECORD_BYTES),
    "file of centroids": (["calibrate", "FILE.json"], LARGEST_RECORD_BYTES),
    "mask of a calibration": (["calibrate", "IMAGE", "--mask", "FILE.png", *UTC], LARGEST_IMAGE_BYTES),
    "camera file of a calibration": (["calibrate", "IMAGE", "--camera", "FILE.json", *UTC], MAX_BYTES),
}


def told(name: str, folder: Path, image: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Run a command of NAMED; exit status and message."""
    words = NAMED[name][0]
    if words[0] == "calibrate":
        words = [*words, "--lat", "0", "--lon", "0", "--out", str(folder / "out.json")]
    camera = str(Path(image).with_name("camera.json"))
    places = {"IMAGE": image, "CAMERA": camera}
    status = main([places.get(word, word.replace("FILE", str(folder / "file"))) for word in words])
    return status, capsys.readouterr().err


def place_of(name: str, folder: Path) -> Path:
    """Where the file of a command of NAMED is; an image has its frame record beside it."""
    if name == "frame record":
        Image.fromarray(np.full((120, 160), 20, np.uint8)).save(folder / "file.png")
        return folder / "file.json"
    (word,) = [word for word in NAMED[name][0] if word.startswith("FILE")]
    return folder / word.replace("FILE", "file")


@pytest.mark.skipif(os.name != "posix", reason="needs links to devices, and pipes")
@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("name", NAMED)
def test_pipes_and_devices_are_not_read(name, kind, tmp_path, image, capsys) -> None:
    path = place_of(name, tmp_path)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    status, words = told(name, tmp_path, image, capsys)
    assert status == 2
    assert words == (
        f"celnav: {name.removesuffix(' of a calibration')} {path} is a pipe or a device, not a regular file: save its "
        "content as a file first\n"
    )


@pytest.mark.parametrize("name", NAMED)
def test_huge_files_are_not_read(name, tmp_path, image, capsys) -> None:
    path = place_of(name, tmp_path)
    with path.open("wb") as stream:
        stream.truncate(NAMED[name][1] + 1)
    status, words = told(name, tmp_path, image, capsys)
    assert status == 2
    assert f"{path} is larger than {NAMED[name][1] // 10**6} MB" in words


def test_folders_and_missing_files_are_left_to_what_reads_them(tmp_path, image, capsys) -> None:
    for place, words in ((tmp_path, "Is a directory"), (tmp_path / "none", "No such file")):
        for option in ("--camera", "--attitude"):
            camera = [] if option == "--camera" else ["--camera", str(Path(image).with_name("camera.json"))]
            assert main(["solve", image, *UTC, *camera, option, str(place)]) == 2
            assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("a", {"star_list": 5}, "frame 'a': star_list must be rows"),
        ("a", {"star_list": {"rows": 5}}, "frame 'a': star_list must be rows"),
        ("a", {"star_list": [[10**400, 1, 2, 3]] * 20}, "frame 'a': star_list has a number beyond the range"),
        ("a\ud800", {}, r"frame 'a\ud800': its name must be that of a file"),
        ("a\0b", {}, r"frame 'a\x00b': its name must be that of a file"),
    ],
)
def test_platepars_of_a_stranger_are_refused_in_a_line(name, change, words, tmp_path, capsys) -> None:
    platepar = {"X_res": 320, "Y_res": 240, "auto_recalibrated": True, "star_list": [ROW] * 20}
    path = tmp_path / "platepars_all_recalibrated.json"
    path.write_text(json.dumps({name: platepar | change}))
    command = ["calibrate", str(path), "--lat", "0", "--lon", "0", "--out", str(tmp_path / "out.json")]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert f"celnav: {path}: {words}" in error
    assert error.count("\n") == 1
