"""Files that `skybench twin` is given, as a stranger could forge them: each is refused in one line, before it is decoded."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from astropy.io import fits
from PIL import EpsImagePlugin, Image
from typer.testing import CliRunner
from unit.benchmark.test_twin_options_imported import SCENE

from benchmark.cli.app import app
from benchmark.errors import PhotographError
from benchmark.twin.given_files import LARGEST_PASSING_BYTES, check_mask, check_photograph, read_given_passing

STACK = "FF_XX0001_20200115_200000_123_0000000.fits"
EPS = "%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 400 400\n%%EndComments\nshowpage\n"
TRAIL = {
    "kind": "aircraft",
    "start": {"azimuth_deg": 10, "altitude_deg": 20},
    "end": {"azimuth_deg": 60, "altitude_deg": 50},
    "v_mag": -1,
}
ALIASES = "a: &a [x, x]\n" + "".join(f"b{n}: &b{n} [*a, *a]\n" for n in range(3))


def stack(path: Path, shape: tuple[int, ...]) -> Path:
    """A stack of video whose pictures have the shape."""
    first = fits.PrimaryHDU()
    first.header.update({"NFRAMES": 256, "FPS": 25.0})
    pictures = [fits.ImageHDU(np.zeros(shape, np.uint8), name=name) for name in ("MAXPIXEL", "AVEPIXEL", "STDPIXEL")]
    fits.HDUList([first, *pictures]).writeto(path)
    return path


def twin(folder: Path, photograph: Path, *words: object) -> str:
    """Run `skybench twin`, which must refuse its input; the message."""
    scene = folder / "scene.yaml"
    scene.write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    command = ["twin", str(photograph), "--scene", str(scene), "--out", str(folder / "out"), *map(str, words)]
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 2, told.output
    return " ".join(told.stderr.split())


@pytest.mark.parametrize("shape", [(3, 400, 400), (1, 400, 400), (400,)])
def test_a_stack_has_pictures_of_two_axes(tmp_path: Path, shape: tuple[int, ...]) -> None:
    path = stack(tmp_path / STACK, shape)
    words = f"its picture MAXPIXEL has {len(shape)} axes"
    with pytest.raises(PhotographError, match=words):
        check_photograph(path)
    assert words in twin(tmp_path, path)


def test_good_stacks_and_other_photographs_pass(tmp_path: Path) -> None:
    check_photograph(stack(tmp_path / STACK, (40, 40)))
    (tmp_path / "text.fits").write_text("no FITS")
    check_photograph(tmp_path / "text.fits")
    damaged = tmp_path / "damaged" / STACK
    damaged.parent.mkdir()
    damaged.write_bytes((tmp_path / STACK).read_bytes()[:3000])
    check_photograph(damaged)
    assert "cannot be read as a stack of video" in twin(tmp_path, damaged)


def test_a_mask_is_a_png_or_a_bmp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ghostscript runs for an EPS, whatever the file's name."""
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *given, **options: pytest.fail("a program was run"))
    (tmp_path / "mask.png").write_text(EPS)
    Image.new("L", (40, 40)).save(tmp_path / "mask.jpg")
    for name in ("mask.png", "mask.jpg", "none.png"):
        with pytest.raises(PhotographError, match=rf"{name}: cannot be read as a picture .* PNG or a BMP"):
            check_mask(tmp_path / name)
    Image.new("L", (40, 40)).save(tmp_path / "mask.bmp")
    Image.new("L", (40, 40)).save(tmp_path / "good.png")
    check_mask(tmp_path / "mask.bmp")
    check_mask(tmp_path / "good.png")
    stated = twin(tmp_path, stack(tmp_path / STACK, (400, 400)), "--mask", tmp_path / "mask.png")
    assert "mask.png: cannot be read as a picture" in stated


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (ALIASES, "aliases are not allowed"),
        ("[" * 20_000, "nested too deep"),
        ("a: 2020-99-99", "expected trails"),
        ("a: " + "9" * 5000, "expected trails"),
        ("", "expected a mapping of keys"),
        ("a: [b: [}", "cannot be read"),
        ("a: []\na: []\n", "given twice"),
        ("#" * LARGEST_PASSING_BYTES + "\n", f"larger than {LARGEST_PASSING_BYTES} bytes"),
    ],
    ids=["aliases", "depth", "date", "digits", "empty", "syntax", "twice", "size"],
)
def test_passing_trails_are_strict_yaml(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "passing.yaml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(PhotographError, match=words) as caught:
        read_given_passing(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "expected trails of a scenario's foreground" in str(caught.value)
    assert words in twin(tmp_path, tmp_path / "night.fits", "--passing", path)


def test_good_passing_trails_are_read(tmp_path: Path) -> None:
    path = tmp_path / "passing.yaml"
    path.write_text(json.dumps({"006": [TRAIL]}), encoding="utf-8")
    assert read_given_passing(path) == {"006": [TRAIL]}


def link_to_zero(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.skipif(os.name != "posix", reason="needs links to devices, and pipes")
@pytest.mark.parametrize("make", [os.mkfifo, link_to_zero])
def test_pipes_and_devices_are_not_read(tmp_path: Path, make: Callable[[Path], None]) -> None:
    path = tmp_path / STACK
    make(path)
    for check, words in (
        (check_photograph, "is a pipe or a device"),
        (check_mask, "is a pipe or a device"),
        (read_given_passing, "not a regular file"),
    ):
        with pytest.raises(PhotographError, match=words):
            check(path)
