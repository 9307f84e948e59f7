"""Folders of `skybench render`: damage is named by their manifest and mended by the same command."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from small_scenes import BASE
from tiny_dataset import fingerprint
from typer.testing import CliRunner

from benchmark.cli.app import app
from generator.errors import GeneratorError
from generator.frame import render as render_module
from generator.frame.folder import IMU_FILE, OBJECTS_FILE, STARS_FILE, UNFINISHED, FrameFolder
from generator.frame.manifest import FRAMES_MANIFEST
from generator.frame.render import render_dataset
from generator.frame.verify import problems
from generator.scenario.file import parse_scenario

MOON = {"utc_start": "2020-02-08T22:00:00Z", "exposure_s": 0.5, "every_s": 1.0, "count": 3}
TREE = BASE | {
    "name": "kept",
    "time": MOON,
    "camera": BASE["camera"] | {"width": 64, "height": 48},
    "imu": {"rate_hz": 10},
    "stars": {"limiting_magnitude": 4.0},
}


@pytest.fixture(scope="module", autouse=True)
def frames_rendered_once():
    """Frames are rendered once, for all runs of this module."""
    known = {}
    render = render_module.render_frame

    def rendered(scenario, index, layers=False, channels=True):
        key = scenario.sha256, index, layers, channels
        if key not in known:
            known[key] = render(scenario, index, layers, channels)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render_module, "render_frame", rendered)
        yield


@pytest.fixture(scope="module")
def scenario():
    return parse_scenario(yaml.safe_dump(TREE), "kept.yaml")


@pytest.fixture(scope="module")
def whole(scenario, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("render") / "frames"
    assert render_dataset(scenario, folder) == ()
    return folder


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "copy"))


def flip(path: Path) -> None:
    """Change one bit in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


WOUNDS: dict[str, Callable[[Path], None]] = {"flip": flip, "cut": cut, "missing": Path.unlink}
NAMES = ("frame-00001.png", "frame-00000.exr", "frame-00002.json", STARS_FILE, OBJECTS_FILE, IMU_FILE)


def test_a_whole_folder(whole) -> None:
    assert problems(whole) == []
    manifest = json.loads((whole / FRAMES_MANIFEST).read_text())
    assert manifest["format"] == "skybench-frames/1"
    assert manifest["frames"] == 3
    assert {file["path"] for file in manifest["files"]} == {
        path.name for path in whole.iterdir() if path.name != FRAMES_MANIFEST
    }
    assert {*NAMES} <= {file["path"] for file in manifest["files"]}
    run = CliRunner().invoke(app, ["verify", str(whole)])
    assert (run.exit_code, run.output) == (0, f"{whole}: whole\n")


@pytest.mark.parametrize("wound", WOUNDS)
@pytest.mark.parametrize("name", NAMES)
def test_damage_is_named_and_mended(scenario, whole, copy, name, wound) -> None:
    WOUNDS[wound](copy / name)
    (problem,) = problems(copy)
    assert problem.startswith(f"{name}: ")
    run = CliRunner().invoke(app, ["verify", str(copy)])
    assert (run.exit_code, run.output) == (1, f"{problem}\n")
    untouched = {
        path: path.stat().st_mtime_ns for path in copy.glob("frame-00001.*") if not name.startswith("frame-00001")
    }
    assert render_dataset(scenario, copy) == (name,)
    assert fingerprint(copy) == fingerprint(whole)
    if name.startswith("frame-") or name == IMU_FILE:
        assert {path: path.stat().st_mtime_ns for path in untouched} == untouched
    assert render_dataset(scenario, copy) == ()


@pytest.mark.parametrize("wound", WOUNDS)
def test_a_damaged_manifest_is_made_again(scenario, whole, copy, wound) -> None:
    WOUNDS[wound](copy / FRAMES_MANIFEST)
    assert problems(copy)
    render_dataset(scenario, copy)
    assert fingerprint(copy) == fingerprint(whole)


def test_files_of_nobody_are_named_and_left(scenario, copy) -> None:
    (copy / "frame-00000-notes.txt").write_text("mine")
    assert problems(copy) == ["frame-00000-notes.txt: not in the manifest"]
    assert render_dataset(scenario, copy) == ()
    assert (copy / "frame-00000-notes.txt").read_text() == "mine"


def test_the_manifest_stays_while_frames_are_mended_and_the_rest_follows_later(scenario, whole, copy) -> None:
    before = (copy / FRAMES_MANIFEST).read_bytes()
    flip(copy / "frame-00001.png")
    (copy / "frame-00002.json").unlink()

    def stop(index: int) -> None:
        if index == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_dataset(scenario, copy, stop)
    assert (copy / FRAMES_MANIFEST).read_bytes() == before
    named = problems(copy)
    assert "frame-00002.json: missing" in named
    assert not [line for line in named if line.startswith("frame-00001")]
    assert set(render_dataset(scenario, copy)) >= {"frame-00002.json"}
    assert fingerprint(copy) == fingerprint(whole)


def test_damage_between_an_interruption_and_the_next_run_is_mended(scenario, whole, tmp_path) -> None:
    def stop(index: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_dataset(scenario, tmp_path / "out", stop)
    assert problems(tmp_path / "out") == [
        f"{tmp_path / 'out' / FRAMES_MANIFEST}: missing; the run is unfinished: run `skybench render` again"
    ]
    flip(tmp_path / "out" / "frame-00000.png")
    render_dataset(scenario, tmp_path / "out")
    assert fingerprint(tmp_path / "out") == fingerprint(whole)


@pytest.mark.parametrize("finished", [False, True])
@pytest.mark.parametrize("name", [STARS_FILE, OBJECTS_FILE])
@pytest.mark.parametrize("wound", [cut, lambda path: path.write_bytes(b""), lambda path: path.write_bytes(b"no table")])
def test_a_frame_with_a_damaged_table_in_an_unfinished_folder_is_made_again(
    scenario, whole, tmp_path, copy, finished, name, wound
) -> None:
    def stop(index: int) -> None:
        if index == 1:
            raise KeyboardInterrupt

    folder = copy if finished else tmp_path / "out"
    if finished:  # its tables are split into single frames again, to mend one of them
        (folder / "frame-00001.png").unlink()
    with pytest.raises(KeyboardInterrupt):
        render_dataset(scenario, folder, stop)
    table = folder / UNFINISHED / f"frame-00000.{name}"
    assert table.is_file()
    wound(table)
    again: list[int] = []
    render = render_module.render_frame
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            render_module, "render_frame", lambda *given, **more: again.append(given[1]) or render(*given, **more)
        )
        render_dataset(scenario, folder)
    assert again == ([0] if finished else [0, 2])
    assert fingerprint(folder) == fingerprint(whole)


def test_a_damaged_table_of_a_frame_without_objects_is_removed(scenario, tmp_path) -> None:
    """It would be read with the others in the end, because the frame does not write one."""
    folder = FrameFolder(tmp_path / "out", scenario)
    folder.open(overwrite=False)
    (folder.folder / UNFINISHED).mkdir()
    (folder.folder / UNFINISHED / f"frame-00000.{OBJECTS_FILE}").write_bytes(b"no table")
    assert folder.missing(exr=False, layers=False) == [0, 1, 2]
    assert not list((folder.folder / UNFINISHED).iterdir())


def test_a_folder_keeps_the_kinds_of_files_that_it_has(scenario, copy) -> None:
    render_dataset(scenario, copy, layers=True)
    assert problems(copy) == []
    layers = {path.name for path in copy.glob("frame-*.*.exr")}
    assert "frame-00000.stars.exr" in layers
    (copy / "frame-00000.stars.exr").unlink()
    (copy / "frame-00001.exr").unlink()
    assert set(render_dataset(scenario, copy, exr=False)) == {"frame-00000.stars.exr", "frame-00001.exr"}
    assert problems(copy) == []
    assert {path.name for path in copy.glob("frame-*.*.exr")} == layers
    assert not (copy / UNFINISHED).exists()


def reworded(folder: Path, change: Callable[[dict], None]) -> list[str]:
    path = folder / FRAMES_MANIFEST
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))
    return problems(folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m["files"].append({"path": "../key", "bytes": 3, "sha256": "0"}), "is not a plain relative path"),
        (lambda m: m["files"].append("x"), "not a manifest"),
        (lambda m: m.update(files={"path": 1}), "not a manifest"),
        (lambda m: m.update(frames=10**12), "frame-00003.png: missing from the manifest"),
        (lambda m: m.update(frames=2), "the manifest says that there are 2 frames"),
        (lambda m: m.update(frames=True), "frames is no number of things"),
        (lambda m: m.update(scenario_sha256="0" * 64), "belongs to another scenario"),
        (lambda m: m.update(more=1), "key more is unknown"),
        (lambda m: m.update(format="skybench-dataset/1"), "not of format"),
    ],
)
def test_a_manifest_of_a_stranger(copy, change, words) -> None:
    found = reworded(copy, change)
    assert any(words in line for line in found), found
    assert len(found) <= 2 * 12


def test_agreement_of_bytes_does_not_make_a_record_true(scenario, copy) -> None:
    """A stranger can write any hash into a manifest; what the files hold is compared too."""
    from generator.stored_files import stored_file

    record = json.loads((copy / "frame-00001.json").read_text())
    record["camera"]["width"] = 65
    (copy / "frame-00001.json").write_text(json.dumps(record))
    measured = stored_file(copy, "frame-00001.json")

    def change(manifest: dict) -> None:
        for file in manifest["files"]:
            if file["path"] == measured.path:
                file.update(bytes=measured.bytes, sha256=measured.sha256)

    assert reworded(copy, change) == [
        "frame-00001.png: is a PNG of 64 x 48 pixels, the frame record's camera has 65 x 48"
    ]


def test_verify_of_a_folder_of_something_else(tmp_path) -> None:
    run = CliRunner().invoke(app, ["verify", str(tmp_path)])
    assert (run.exit_code, run.stdout) == (2, "")
    assert "neither a dataset of `skybench generate` nor a folder of `skybench render`" in run.output
    run = CliRunner().invoke(app, ["verify", str(tmp_path / "nowhere")])
    assert (run.exit_code, run.stdout) == (2, "")
    assert "nowhere: no such folder" in run.output
    (tmp_path / "scenario.yaml").write_text("name: begun\n")
    run = CliRunner().invoke(app, ["verify", str(tmp_path)])
    assert run.exit_code == 1
    assert "manifest.json: missing; the run is unfinished" in run.output


def test_another_scenario_is_refused_with_its_manifest_kept(whole, copy) -> None:
    other = parse_scenario(yaml.safe_dump(TREE | {"seed": 8}), "other.yaml")
    with pytest.raises(GeneratorError, match="holds frames of another scenario"):
        render_dataset(other, copy)
    assert fingerprint(copy) == fingerprint(whole)
    render_dataset(other, copy, overwrite=True)
    assert problems(copy) == []
