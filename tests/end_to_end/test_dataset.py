"""Datasets: identity of frames, resuming after a kill, faults, and verification."""

import hashlib
import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow.dataset
import pytest
import yaml
from PIL import Image
from small_scenes import BASE
from tiny_dataset import SPEC, TINY, fingerprint, members, start
from typer.testing import CliRunner

from benchmark.cli.app import app
from generator.dataset import generate as generate_module
from generator.dataset import shard as shard_module
from generator.dataset.generate import generate
from generator.dataset.images import decode
from generator.dataset.layout import DatasetSpec, divide
from generator.dataset.reader import Dataset
from generator.dataset.run import Part, ShardRange
from generator.dataset.target import LocalTarget
from generator.dataset.verify import problems
from generator.errors import GeneratorError, ScenarioError
from generator.frame.object_table import OBJECT_SCHEMA
from generator.scenario.file import load_scenario

ROOT = Path(__file__).parents[2]


@pytest.fixture
def copy(dataset, tmp_path) -> Path:
    return Path(shutil.copytree(dataset, tmp_path / "copy"))


def test_manifest_lists_every_file_and_verifies(dataset) -> None:
    manifest = json.loads((dataset / "manifest.json").read_text())
    listed = {file["path"] for file in manifest["files"]}
    present = {
        str(path.relative_to(dataset))
        for path in dataset.rglob("*")
        if path.is_file() and not path.relative_to(dataset).parts[0].startswith(("logs", "receipts", "manifest"))
    }
    assert listed == present
    assert problems(dataset) == []


@pytest.mark.journey
@pytest.mark.parametrize(("shard_size", "workers"), [(5, 2), (3, 1)])
def test_bytes_do_not_depend_on_workers_or_shards(dataset, scenario_path, tmp_path, shard_size, workers) -> None:
    spec = DatasetSpec(shard_size=shard_size, exr=True)
    generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "other", spec, workers=workers)
    assert members(tmp_path / "other") == members(dataset)
    if shard_size == SPEC.shard_size:
        assert fingerprint(tmp_path / "other") == fingerprint(dataset)


def test_one_frame_alone_has_the_same_bytes(dataset, scenario_path, tmp_path) -> None:
    generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "one", SPEC, frames=(7, 8))
    alone, full = members(tmp_path / "one"), members(dataset)
    assert set(alone) == {"frame-00007.png", "frame-00007.json", "frame-00007.exr"}
    assert all(full[name] == data for name, data in alone.items())
    assert problems(tmp_path / "one") == []


def test_jpeg_xl_holds_the_same_numbers(dataset, scenario_path, tmp_path) -> None:
    spec = DatasetSpec(shard_size=5, codec="jxl")
    generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "jxl", spec, frames=(7, 8))
    stored = members(tmp_path / "jxl")
    assert set(stored) == {"frame-00007.jxl", "frame-00007.json"}
    np.testing.assert_array_equal(
        decode(stored["frame-00007.jxl"], "jxl"), decode(members(dataset)["frame-00007.png"], "png")
    )
    assert problems(tmp_path / "jxl") == []


def test_parts_make_the_whole(dataset, scenario_path, tmp_path) -> None:
    scenario, text = load_scenario(scenario_path), scenario_path.read_text()
    first = generate(scenario, text, tmp_path / "parts", SPEC, part=Part(0, 2))
    assert first.missing
    assert not (tmp_path / "parts" / "manifest.json").exists()
    assert not generate(scenario, text, tmp_path / "parts", SPEC, part=Part(1, 2)).missing
    assert fingerprint(tmp_path / "parts") == fingerprint(dataset)


def test_ranges_of_shards_make_the_whole(dataset, scenario_path, tmp_path) -> None:
    scenario, text = load_scenario(scenario_path), scenario_path.read_text()
    count = len(divide(scenario, SPEC, 0, scenario.frame_count))
    ranges = ShardRange(0, 1), ShardRange(1, count)
    first = generate(scenario, text, tmp_path / "ranges", SPEC, part=ranges[0])
    assert [report.shard.index for report in first.reports] == [0]
    assert len(first.missing) == count - 1
    assert not generate(scenario, text, tmp_path / "ranges", SPEC, part=ranges[1]).missing
    assert fingerprint(tmp_path / "ranges") == fingerprint(dataset)


def test_a_job_of_many_asks_a_store_for_lists_and_not_for_each_shard(copy, scenario_path, monkeypatch) -> None:
    """A million frames are ten thousand shards: a thousand jobs that asked for each of them would ask ten million times."""
    asked = []

    class Watched(LocalTarget):
        def read(self, place: str) -> bytes | None:
            asked.append(place)
            return super().read(place)

        def size(self, place: str) -> int | None:
            asked.append(place)
            return super().size(place)

    (copy / "manifest.json").unlink()
    (copy / "receipts/train/shard-000001.json").unlink()
    monkeypatch.setattr(generate_module, "open_target", lambda out: Watched(Path(out)))
    scenario, text = load_scenario(scenario_path), scenario_path.read_text()
    nothing = generate(scenario, text, copy, SPEC, part=ShardRange(0, 1), run=lambda *arguments: iter(()))
    assert [shard.index for shard in nothing.missing] == [1]
    assert not [place for place in asked if "shard" in place]


def test_a_folder_of_another_scenario_is_refused(copy, scenario_path, tmp_path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(TINY | {"seed": 99}))
    with pytest.raises(GeneratorError, match="another scenario"):
        generate(load_scenario(other), other.read_text(), copy, SPEC)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("precious")
    with pytest.raises(GeneratorError, match=r"thesis\.tex"):
        generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "mine", SPEC)


def test_a_frame_that_fails_is_retried_then_reported(scenario_path, tmp_path, monkeypatch, dataset) -> None:
    calls: list[int] = []
    render = shard_module.render_frame

    def fragile(scenario, index, **options):
        calls.append(index)
        if index == 6 or (index == 2 and calls.count(2) == 1):
            raise RuntimeError("cosmic ray")
        return render(scenario, index, **options)

    monkeypatch.setattr(shard_module, "render_frame", fragile)
    report = generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "failing", SPEC)
    assert [(failure.index, failure.error) for failure in report.failures] == [(6, "RuntimeError: cosmic ray")]
    assert calls.count(6) == shard_module.TRIES_PER_FRAME
    assert [shard.index for shard in report.missing] == [1]
    assert sorted(path.name for path in (tmp_path / "failing/data/train").iterdir()) == [
        "shard-000000.tar",
        "shard-000002.tar",
    ]
    assert "cosmic ray" in (tmp_path / "failing/logs/train/shard-000001.log").read_text()
    monkeypatch.setattr(shard_module, "render_frame", render)
    generate(load_scenario(scenario_path), scenario_path.read_text(), tmp_path / "failing", SPEC)
    assert fingerprint(tmp_path / "failing") == fingerprint(dataset)


def reword(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda folder: flip(folder / "data/train/shard-000001.tar"), "data/train/shard-000001.tar: its contents"),
        (lambda folder: (folder / "data/train/shard-000002.tar").unlink(), "data/train/shard-000002.tar: missing"),
        (lambda folder: os.truncate(folder / "stars/train/shard-000000.parquet", 500), "shard-000000.parquet: has 500"),
        (lambda folder: (folder / "stray.txt").write_text("?"), "stray.txt: not in the manifest"),
        (lambda folder: flip(folder / "receipts/train/shard-000001.json"), "receipts/train/shard-000001.json: "),
        (lambda folder: (folder / "receipts/train/more.json").write_text("{}"), "more.json: not in the manifest"),
        (lambda folder: (folder / "manifest.json").unlink(), "manifest.json: missing"),
        (lambda folder: reword(folder / "manifest.json", '"seed": 7', '"seed": 8'), "manifest.json: seed is 8"),
        (lambda folder: reword(folder / "manifest.json", '"tiny"', '"tidy"'), "manifest.json: scenario is 'tidy'"),
        (lambda folder: (folder / "manifest.json").write_text("{}"), "manifest.json: not a manifest"),
        (
            lambda folder: (folder / "scenario.yaml").write_text(yaml.safe_dump(TINY | {"seed": 4})),
            "manifest.json: belongs to another scenario",
        ),
    ],
)
def test_verify_names_what_is_wrong(copy, damage, named) -> None:
    damage(copy)
    run = CliRunner().invoke(app, ["verify", str(copy)])
    assert run.exit_code == 1
    assert named in run.output


DAMAGES = {
    "data/train/shard-000001.tar": flip,
    "stars/train/shard-000000.parquet": flip,
    "frames/train/shard-000002.parquet": Path.unlink,
    "scenario.yaml": flip,
    "README.md": flip,
    "croissant.json": Path.unlink,
    "manifest.json": lambda path: os.truncate(path, 100),
    "receipts/train/shard-000002.json": flip,
}


@pytest.mark.parametrize("places", [[place] for place in DAMAGES] + [[*DAMAGES][:6]], ids="+".join)
def test_running_again_mends_what_verify_names(copy, dataset, scenario_path, places) -> None:
    for place in places:
        DAMAGES[place](copy / place)
    named = {problem.split(": ")[0].removeprefix(f"{copy}/") for problem in problems(copy)}
    assert named & set(places) or "scenario.yaml" in places
    run = CliRunner().invoke(app, ["generate", str(scenario_path), "--out", str(copy), "--shard-size", "5", "--exr",
                                   "--workers", "0"])  # fmt: skip
    assert run.exit_code == 0, run.output
    for place in places:
        if not place.startswith("receipts"):
            assert f"{place}: was damaged or missing, and is made again" in run.output
    assert fingerprint(copy) == fingerprint(dataset)
    assert problems(copy) == []


def test_the_manifest_stays_until_a_new_one_is_whole(copy, scenario_path, monkeypatch) -> None:
    def full(*arguments):
        raise OSError(28, "No space left on device", "disk")

    monkeypatch.setattr(generate_module, "write_card", full)
    before = (copy / "manifest.json").read_bytes()
    with pytest.raises(GeneratorError, match="No space left on device"):
        generate(load_scenario(scenario_path), scenario_path.read_text(), copy, SPEC)
    assert (copy / "manifest.json").read_bytes() == before
    assert problems(copy) == []


def test_manifest_may_not_point_outside(copy) -> None:
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["files"][0]["path"] = "../../etc/passwd"
    (copy / "manifest.json").write_text(json.dumps(manifest))
    assert "outside the folder" in problems(copy)[0]


def test_objects_have_typed_columns_with_units(dataset) -> None:
    """The satellite is in every frame; the Moon, where it is up and in the field, is the brightest thing there."""
    objects = pyarrow.dataset.dataset(dataset / "objects" / "train", format="parquet").to_table()
    assert objects.schema.equals(OBJECT_SCHEMA)
    assert objects.schema.field("electrons_e").metadata[b"unit"] == b"e"
    rows = objects.to_pandas()
    assert rows.loc[rows["kind"] == "satellite", "index"].tolist() == list(range(12))
    moon = rows[rows["kind"] == "moon"]
    assert (moon["object"] == -1).all()
    records = {name: json.loads(data) for name, data in members(dataset).items() if name.endswith(".json")}
    up = {record["index"] for record in records.values() if record["sky"]["moon_altitude_deg"] > 35}
    assert up <= set(moon["index"])
    assert moon["electrons_e"].min() > rows.loc[rows["kind"] == "satellite", "electrons_e"].max()


WITH_FILE = BASE | {
    "name": "walled",
    "camera": {"width": 48, "height": 32, "hfov_deg": 140, "aperture_mm": 4},
    "stars": {"limiting_magnitude": 3.0},
    "sensor": {"quantum_efficiency": "qe.csv", "develop": {}, "hud": True},
}


def walled_scenario(folder: Path, place: str = "land/ridge.csv") -> Path:
    """A scenario that names a horizon profile, with the profile beside it."""
    (folder / place).parent.mkdir(parents=True, exist_ok=True)
    (folder / place).write_text("azimuth_deg,elevation_deg\n0,20\n180,30\n")
    (folder / "qe.csv").write_text("wavelength_nm,quantum_efficiency\n400,0.5\n700,0.6\n")
    tree = WITH_FILE | {"foreground": {"horizon": {"file": place}, "lit_directions": 0}}
    (folder / "walled.yaml").write_text(yaml.safe_dump(tree))
    return folder / "walled.yaml"


def test_files_that_a_scenario_names_go_with_the_dataset(tmp_path) -> None:
    """With the scenario's folder gone, the dataset verifies, and its own copy makes the same bytes again."""
    path = walled_scenario(tmp_path / "scenes")
    generate(load_scenario(path), path.read_text(), tmp_path / "set", DatasetSpec())
    shutil.rmtree(tmp_path / "scenes")
    assert problems(tmp_path / "set") == []
    assert {"frame-00000.developed.png", "frame-00000.hud.png"} <= set(members(tmp_path / "set"))
    listed = {file.path: file.sha256 for file in Dataset.open(tmp_path / "set").manifest.files}
    kept = tmp_path / "set" / "land/ridge.csv"
    assert "qe.csv" in listed
    assert listed["land/ridge.csv"] == hashlib.sha256(kept.read_bytes()).hexdigest()
    copy = tmp_path / "set" / "scenario.yaml"
    generate(load_scenario(copy), copy.read_text(), tmp_path / "again", DatasetSpec())
    assert fingerprint(tmp_path / "again") == fingerprint(tmp_path / "set")
    kept.write_text(kept.read_text() + "200,31\n")
    assert any("land/ridge.csv: has" in problem for problem in problems(tmp_path / "set"))
    kept.unlink()
    assert any("land/ridge.csv" in problem for problem in problems(tmp_path / "set"))


def test_a_begun_dataset_of_a_file_that_changed_is_refused(tmp_path) -> None:
    path = walled_scenario(tmp_path)
    generate(load_scenario(path), path.read_text(), tmp_path / "set", DatasetSpec())
    (tmp_path / "land/ridge.csv").write_text("azimuth_deg,elevation_deg\n0,2\n180,3\n")
    with pytest.raises(GeneratorError, match=r"land/ridge\.csv: differs"):
        generate(load_scenario(path), path.read_text(), tmp_path / "set", DatasetSpec())


def test_a_file_that_changes_during_the_run_fails_its_frames(tmp_path) -> None:
    """Frames of the old and of the new file never stand side by side under one hash."""
    path = walled_scenario(tmp_path)
    scenario = load_scenario(path)
    (tmp_path / "land/ridge.csv").write_text("azimuth_deg,elevation_deg\n0,2\n180,3\n")
    with pytest.raises(ScenarioError, match=r"'land/ridge\.csv' changed since the scenario was read"):
        scenario.frame(0)
    with pytest.raises(GeneratorError, match="changed since the scenario was read"):
        generate(scenario, path.read_text(), tmp_path / "set", DatasetSpec())


@pytest.mark.parametrize(
    ("place", "message"), [("stars/ridge.csv", "keeps its own 'stars'"), ("my ridge.csv", "use letters")]
)
def test_files_whose_names_a_dataset_cannot_bear_are_refused(tmp_path, place, message) -> None:
    path = walled_scenario(tmp_path, place)
    with pytest.raises(GeneratorError, match=message):
        generate(load_scenario(path), path.read_text(), tmp_path / "set", DatasetSpec())
    assert not (tmp_path / "set").exists()


def test_a_file_that_cannot_be_read_is_named(tmp_path) -> None:
    path = walled_scenario(tmp_path)
    (tmp_path / "land/ridge.csv").unlink()
    process = start("generate", str(path), "--out", str(tmp_path / "set"))
    _, errors = process.communicate()
    assert process.returncode == 2
    assert "foreground.horizon.file: found 'land/ridge.csv', which cannot be read" in errors
    assert not (tmp_path / "set").exists()


def test_card_names_the_recipe_and_shows_the_frames(dataset) -> None:
    card = (dataset / "README.md").read_text()
    for phrase in ("skybench generate scenario.yaml", "--shard-size 5 --exr", "12 frames", "## Limits"):
        assert phrase in card
    with Image.open(dataset / "card/contact-sheet.png") as sheet:
        assert sheet.width > 600
    assert (dataset / "card/histograms.svg").read_text().startswith("<svg")


def test_every_column_of_frames_is_documented(dataset) -> None:
    text = (ROOT / "docs/dataset_format.md").read_text().split("### frames\n")[1].split("###")[0]
    documented = set(re.findall(r"`([^`]+)`", text))
    assert documented == set(Dataset.open(dataset).frames().schema.names)


def test_reader_gives_back_images_and_tables(dataset) -> None:
    opened = Dataset.open(dataset)
    stored = list(opened.stored_frames())
    assert len(stored) == opened.frames().num_rows == 12
    hashes = opened.frames()["image_sha256"].to_pylist()
    assert [hashlib.sha256(frame.members["png"]).hexdigest() for frame in stored] == hashes


@pytest.mark.parametrize(
    "arguments",
    [
        ["--frames", "3:1"],
        ["--frames", "0:99"],
        ["--frames", "x"],
        ["--part", "2/2"],
        ["--part", "²/3"],
        ["--shards", "0"],
        ["--shards", "2:2"],
        ["--shards", "1:99"],
        ["--shards", "0:1", "--part", "0/2"],
        ["--codec", "gif"],
    ],
)
def test_bad_options_exit_2(scenario_path, tmp_path, arguments) -> None:
    run = CliRunner().invoke(app, ["generate", str(scenario_path), "--out", str(tmp_path / "out"), *arguments])
    assert run.exit_code == 2
    assert arguments[0].strip("-").rstrip("s") in run.stderr
    assert isinstance(run.exception, SystemExit)
