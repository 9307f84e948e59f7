"""Tasks of photographs: frozen, fetched by hash, imported once, graded, and solved."""

import bz2
import gzip
import hashlib
import io
import json
import shutil
import urllib.error
from pathlib import Path

import pytest
import yaml
from photograph_files import PLACE, standin, write_camera, write_fits
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import TaskError
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.importing.told import read_told
from benchmark.importing.write import Import, import_photographs
from benchmark.real_tasks import definition, fetch
from benchmark.real_tasks.definition import load_real_task, real_task_names
from benchmark.run.engine import run as run_engine
from benchmark.tasks.definition import task_names

FROZEN = {
    "allsky-real@1": "09fa5f97e78a3177a907f812564b3bc1ae43fa13f073853ec9e432b272668097",
    "meteor-centroids@1": "f04b29c8708d282ecd4204add47fe6e73aa65b238860e30bb5b8b2bf1662de5d",
    "meteor-real@2": "899810405393702c73291e3425788fc2ed3c8a3b2f640552441d056488e46078",
}
SHIPPED = Path(__file__).parents[2] / "data" / "allsky"


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), (arguments, result.exception)
    return result.exit_code, result.output if result.exit_code else result.stdout


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A task of two stand-ins, ``small-real``; returns the folder that its photographs are published in."""
    published, folder = tmp_path / "published", tmp_path / "definition"
    published.mkdir()
    folder.mkdir()
    write_fits(published / "a.fits")
    write_fits(published / "b.fits", standin(seed=2))
    write_camera(folder / "small-real.camera.json")
    sources = [
        {
            "file": path.name,
            "condition": value,
            "bytes": path.stat().st_size,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        }
        for path, value in zip(sorted(published.iterdir()), (30, 60), strict=True)
    ]
    content = {
        "name": "small-real", "revision": 1, "title": "Two stand-ins of photographs", "licence": "CC0-1.0",
        "credit": "nobody", "origin": "these tests", "camera": "small-real.camera.json", "calibrated_on": "nothing",
        "site": {"latitude_deg": PLACE.latitude_deg, "longitude_deg": PLACE.longitude_deg, "height_m": PLACE.height_m},
        "condition": {"name": "nights", "unit": "d", "values": [30, 60], "harder": "higher"},
        "address": "https://photographs.invalid/", "sources": sources,
    }  # fmt: skip
    (folder / "small-real.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    monkeypatch.setattr(definition, "FOLDER", folder)
    return published


def test_no_task_changes_without_a_new_revision() -> None:
    found = {load_real_task(name).label: load_real_task(name).sha256 for name in real_task_names()}
    assert found == FROZEN, "a task's meaning changed: raise its revision, and freeze the hash of the new one"
    assert not set(real_task_names()) & set(task_names())


def test_the_shipped_photograph_is_one_of_the_tasks() -> None:
    (source,) = [each for each in load_real_task("allsky-real").definition.sources if each.file == "005.fits.bz2"]
    assert hashlib.sha256((SHIPPED / "005.fits.bz2").read_bytes()).hexdigest() == source.sha256


def test_the_calibrated_photograph_is_none_of_the_tasks() -> None:
    for name in real_task_names():
        found = load_real_task(name).definition
        frames = {source.file for source in found.sources} | {each.frame for each in found.drawn}
        assert found.calibrated_on.partition(",")[0] not in frames


@pytest.mark.journey
def test_a_real_photograph_is_solved_with_the_camera_of_another_night(tmp_path: Path) -> None:
    task = load_real_task("allsky-real")
    told = read_told(task.camera_file)
    (made,) = import_photographs(Import("one", [SHIPPED / "005.fits.bz2"], task.place, told), tmp_path / "set")
    assert made.stars > 300
    assert made.rms_px is not None
    assert made.rms_px < 0.25
    (done,) = run_engine(tmp_path / "set", ["skybench"], tmp_path / "results")
    # The mount tilts by 0.02 deg from night to night, 2 km.
    assert done.summary.median_error_km.value < 5
    assert done.summary.star_precision.value > 0.97


def test_photographs_are_fetched_by_address_and_hash(small: Path, tmp_path: Path, monkeypatch) -> None:
    task, asked = load_real_task("small-real"), []

    def answer(address: str, timeout: float) -> io.BytesIO:
        asked.append(address)
        return io.BytesIO((small / address.rpartition("/")[2]).read_bytes())

    monkeypatch.setattr(fetch.urllib.request, "urlopen", answer)
    assert fetch.fetch_sources(task, tmp_path / "data") == ["a.fits", "b.fits"]
    assert asked == ["https://photographs.invalid/a.fits", "https://photographs.invalid/b.fits"]
    assert fetch.missing_sources(task, tmp_path / "data") == []
    assert fetch.fetch_sources(task, tmp_path / "data") == []
    assert len(asked) == 2


def test_what_is_not_the_photograph_is_not_kept(small: Path, tmp_path: Path, monkeypatch) -> None:
    task = load_real_task("small-real")
    monkeypatch.setattr(fetch.urllib.request, "urlopen", lambda address, timeout: io.BytesIO(b"<html>"))
    with pytest.raises(TaskError, match=r"a\.fits: is not the photograph .*--from"):
        fetch.fetch_sources(task, tmp_path / "data")
    assert len(fetch.missing_sources(task, tmp_path / "data")) == 2


def test_without_a_network_the_remedy_is_said(small: Path, tmp_path: Path, monkeypatch) -> None:
    def refuse(address: str, timeout: float) -> io.BytesIO:
        raise urllib.error.URLError("Name or service not known")

    monkeypatch.setattr(fetch.urllib.request, "urlopen", refuse)
    code, text = run("fetch", "small-real", "--data", tmp_path / "data")
    assert code == 2
    assert "https://photographs.invalid/a.fits: cannot be fetched" in text
    assert "skybench fetch small-real --from FOLDER" in text


@pytest.mark.parametrize(("ending", "pack"), [("", bytes), (".gz", gzip.compress), (".bz2", bz2.compress)])
def test_photographs_are_taken_from_a_folder_packed_or_not(small: Path, tmp_path: Path, ending: str, pack) -> None:
    (tmp_path / "mine" / "below").mkdir(parents=True)
    for path in small.iterdir():
        (tmp_path / "mine" / "below" / f"{path.name}{ending}").write_bytes(pack(path.read_bytes()))
    code, text = run("fetch", "small-real", "--from", tmp_path / "mine", "--data", tmp_path / "data", "--json")
    assert code == 0
    assert json.loads(text)["fetched"] == ["a.fits", "b.fits"]


def test_another_photograph_of_the_name_is_refused(small: Path, tmp_path: Path) -> None:
    task = load_real_task("small-real")
    shutil.copyfile(small / "a.fits", small / "b.fits")
    with pytest.raises(TaskError, match=r"b\.fits: is not the photograph of small-real@1"):
        fetch.fetch_sources(task, tmp_path / "data", small)
    (small / "b.fits").unlink()
    with pytest.raises(TaskError, match=r"b\.fits is not in it"):
        fetch.fetch_sources(task, tmp_path / "data", small)


def test_a_packed_file_is_unpacked_no_further_than_the_photograph(small: Path, tmp_path: Path) -> None:
    (small / "a.fits").unlink()
    (small / "a.fits.gz").write_bytes(gzip.compress(bytes(50_000_000)))
    with pytest.raises(TaskError, match="is not the photograph"):
        fetch.fetch_sources(load_real_task("small-real"), tmp_path / "data", small)


@pytest.mark.journey
def test_a_task_of_photographs_is_run_and_reported(small: Path, tmp_path: Path) -> None:
    data, results = tmp_path / "data", tmp_path / "results"
    code, text = run("bench", "run", "small-real", "--solver", "skybench", "--data", data, "--out", results)
    assert (code, "run: skybench fetch small-real" in text) == (2, True)
    assert run("fetch", "small-real", "--from", small, "--data", data)[0] == 0
    code, text = run("bench", "run", "small-real", "--solver", "skybench", "--data", data, "--out", results, "--json")
    assert code == 0, text
    assert json.loads(text)["runs"][0]["summary"]["n_fixes"] == 2
    code, text = run("bench", "report", "--out", results, "--data", data)
    assert code == 0, text
    assert "small-real@1" in text
    frames = open_frames("small-real@1", FrameChoice(data=data))
    assert [frame.condition for frame in frames.frames] == [30, 60]
    assert (frames.facts.label, frames.facts.part) == ("small-real@1", "all")
    assert len(open_frames("small-real", FrameChoice(data=data, condition=60)).frames) == 1


def test_choices_that_photographs_do_not_have_are_refused(small: Path, tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="--frames"):
        open_frames("small-real", FrameChoice(data=tmp_path, per_condition=1))
    with pytest.raises(TaskError, match="one of its values: 30, 60"):
        open_frames("small-real", FrameChoice(data=tmp_path, condition=5))
    with pytest.raises(TaskError, match="revision 1"):
        load_real_task("small-real@2")
    with pytest.raises(TaskError, match="known: small-real"):
        load_real_task("large-real")


def test_a_faulty_definition_is_named(small: Path) -> None:
    path = definition.FOLDER / "small-real.yaml"
    content = yaml.safe_load(path.read_text())
    content["sources"][0]["condition"] = 45
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(TaskError, match="condition 45 is none of"):
        load_real_task("small-real")
    content["sources"][0] |= {"condition": 30, "address": "file:///etc/passwd"}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(TaskError, match="address"):
        load_real_task("small-real")
