"""Landscape packages compressed by methods that Python unpacks without a limit: refused before anything is unpacked."""

import io
import tracemalloc
import zipfile
from pathlib import Path

import pytest
import yaml
from PIL import Image
from small_scenes import BASE
from typer.testing import CliRunner

from benchmark.cli.app import app
from generator.errors import ScenarioError
from generator.ground.stellarium.landscape import read_landscape
from generator.ground.stellarium.package import PackageError
from generator.scenario.file import load_scenario

INI = "[landscape]\nname = x\ntype = spherical\nmaptex = a.png\n"
UNPACKED_BYTES = 100_000_000
UNBOUNDED = [(zipfile.ZIP_BZIP2, "bzip2"), (zipfile.ZIP_LZMA, "LZMA")]
PERMITTED = [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]


def package(path: Path, kind: int, more: int = 0) -> Path:
    picture = io.BytesIO()
    Image.new("RGBA", (64, 32)).save(picture, "PNG")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x/a.png", picture.getvalue())
        archive.writestr("x/landscape.ini", INI + "\n" * more, compress_type=kind)
    return path


def scene(folder: Path, landscape: object) -> Path:
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(BASE | {"foreground": {"landscape": landscape}}), encoding="utf-8")
    return path


@pytest.mark.parametrize(("kind", "name"), UNBOUNDED)
def test_a_bomb_of_an_unbounded_method_is_not_unpacked(tmp_path, kind, name) -> None:
    package(tmp_path / "bomb.zip", kind, UNPACKED_BYTES)
    tracemalloc.start()
    try:
        with pytest.raises(ScenarioError) as caught:
            load_scenario(scene(tmp_path, {"file": "bomb.zip"}))
        assert tracemalloc.get_traced_memory()[1] < UNPACKED_BYTES / 4
    finally:
        tracemalloc.stop()
    for part in (
        "scene.yaml: foreground.landscape: 'bomb.zip'",
        f"'x/landscape.ini' is compressed by {name}",
        "pack it again",
    ):
        assert part in str(caught.value)


def test_a_bomb_among_the_values_of_a_sweep_is_found(tmp_path) -> None:
    package(tmp_path / "good.zip", zipfile.ZIP_DEFLATED)
    package(tmp_path / "Bomb.ZIP", zipfile.ZIP_BZIP2)
    path = scene(tmp_path, {"file": {"sweep": ["good.zip", "./Bomb.ZIP"]}})
    with pytest.raises(ScenarioError, match=r"'\./Bomb\.ZIP': 'x/landscape\.ini' is compressed by bzip2"):
        load_scenario(path)


@pytest.mark.parametrize("kind", PERMITTED)
def test_stored_and_deflated_packages_are_read(tmp_path, kind) -> None:
    package(tmp_path / "a.zip", kind)
    assert load_scenario(scene(tmp_path, {"file": "a.zip"})).frame_count == 1


def test_what_is_no_package_is_left_to_the_reader(tmp_path) -> None:
    (tmp_path / "text.zip").write_text("no archive")
    for name, words in (("text.zip", "is not a zip archive"), ("none.zip", "cannot be read"), ("../a.zip", "leaves")):
        with pytest.raises(ScenarioError, match=words):
            load_scenario(scene(tmp_path, {"file": name}))
    with pytest.raises(PackageError, match="method 97"):
        read_landscape(_of_method(package(tmp_path / "a.zip", zipfile.ZIP_STORED), 97), "a.zip")


def _of_method(path: Path, method: int) -> Path:
    """Change the method of the last member in the archive's list."""
    data = bytearray(path.read_bytes())
    start = data.rfind(b"PK\x01\x02")
    data[start + 10 : start + 12] = method.to_bytes(2, "little")
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    "command",
    [
        ["plan", "SCENE"],
        ["render", "SCENE", "--out", "OUT"],
        ["generate", "SCENE", "--out", "OUT"],
        ["demo", "--scenario", "SCENE", "--frames", "OUT", "--out", "OUT"],
        ["twin", "photograph.fits", "--scene", "SCENE", "--out", "OUT"],
        ["study", "calibration", "--scenario", "SCENE", "--work", "OUT", "--out", "OUT"],
        ["study", "independence", "--scenario", "SCENE", "--work", "OUT", "--out", "OUT"],
        ["study", "realism", "photograph.fits", "--scene", "SCENE", "--work", "OUT", "--out", "OUT"],
        ["study", "thesis", "--scenario", "SCENE", "--work", "OUT", "--out", "OUT"],
    ],
    ids=" ".join,
)
def test_every_command_that_reads_a_scenario_refuses_it(tmp_path, command) -> None:
    package(tmp_path / "bomb.zip", zipfile.ZIP_BZIP2)
    places = {"SCENE": str(scene(tmp_path, {"file": "bomb.zip"})), "OUT": str(tmp_path / "out")}
    told = CliRunner().invoke(app, [places.get(word, word) for word in command])
    assert told.exit_code == 2, told.output
    assert "is compressed by bzip2" in told.output
