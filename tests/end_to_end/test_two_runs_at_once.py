"""Two runs that write the same frames at the same time: none loses what the other made."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import yaml
from small_scenes import BASE
from tiny_dataset import SPEC, fingerprint
from typer.testing import CliRunner

from benchmark.cli.app import app
from generator.dataset import generate as generate_module
from generator.dataset import shard as shard_module
from generator.dataset.generate import INCOMING_PREFIX, UNFINISHED_PREFIX, generate
from generator.dataset.run import Part
from generator.dataset.target import LocalTarget
from generator.dataset.verify import problems
from generator.errors import GeneratorError
from generator.folder_lock import only_writer
from generator.frame.folder import STARS_FILE
from generator.frame.manifest import FRAMES_MANIFEST, FramesManifest, read_frames_manifest, write_manifest
from generator.frame.render import render_dataset
from generator.frame.verify import problems as folder_problems
from generator.scenario.file import load_scenario, parse_scenario
from generator.stored_files import stored_file

TREE = BASE | {
    "name": "shared",
    "frames": 2,
    "camera": BASE["camera"] | {"width": 48, "height": 32},
    "stars": {"limiting_magnitude": 4.0},
}


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rendered") / "frames"
    render_dataset(parse_scenario(yaml.safe_dump(TREE), "shared.yaml"), folder)
    return folder


def test_a_second_render_into_a_folder_is_refused_while_the_first_runs(rendered, tmp_path) -> None:
    scene = tmp_path / "shared.yaml"
    scene.write_text(yaml.safe_dump(TREE))
    before = fingerprint(rendered)
    with only_writer(rendered):
        run = CliRunner().invoke(app, ["render", str(scene), "--out", str(rendered)])
    assert run.exit_code == 2
    assert f"{rendered}: another run is writing it" in run.output
    assert fingerprint(rendered) == before
    run = CliRunner().invoke(app, ["render", str(scene), "--out", str(rendered)])
    assert run.exit_code == 0, run.output
    assert fingerprint(rendered) == before


def test_a_folder_that_cannot_be_made_is_named(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GeneratorError, match="file/frames: cannot be written"), only_writer(tmp_path / "file/frames"):
        pass


def cut_stars(path: Path) -> None:
    """Leave out a frame's rows, as a run whose rows another one cleared away."""
    table = pq.read_table(path)
    pq.write_table(table.filter(pc.not_equal(table["index"], 1)), path)


def test_verify_names_frames_without_their_stars(rendered, tmp_path) -> None:
    copy = Path(shutil.copytree(rendered, tmp_path / "copy"))
    cut_stars(copy / STARS_FILE)
    known = read_frames_manifest(copy)
    files = tuple(stored_file(copy, file.path) if file.path == STARS_FILE else file for file in known.files)
    write_manifest(copy, FramesManifest(**{**vars(known), "files": files}))
    (problem,) = folder_problems(copy)
    assert problem.startswith(f"{STARS_FILE}: has 0 rows of frame-00001, its record says ")
    (copy / FRAMES_MANIFEST).unlink()


def test_verify_names_frames_of_a_dataset_without_their_stars(dataset, tmp_path) -> None:
    copy = Path(shutil.copytree(dataset, tmp_path / "copy"))
    shutil.rmtree(copy / "receipts")
    place = "stars/train/shard-000000.parquet"
    before = stored_file(copy, place)
    cut_stars(copy / place)
    after = stored_file(copy, place)
    manifest = (copy / "manifest.json").read_text().replace(before.sha256, after.sha256)
    (copy / "manifest.json").write_text(manifest.replace(f'"bytes": {before.bytes},', f'"bytes": {after.bytes},'))
    (problem,) = problems(copy)
    assert problem.startswith(f"{place}: has 0 rows of frame-00001, its record says ")


def clear_away(folder: Path) -> None:
    """What a job does at its end with the temporary files of others."""
    for prefix in (UNFINISHED_PREFIX, INCOMING_PREFIX):
        for leftover in folder.rglob(f"{prefix}*"):
            leftover.unlink()


def test_a_job_whose_shards_another_one_finishes_meanwhile_counts_them_as_made(
    dataset, scenario_path, tmp_path, monkeypatch
) -> None:
    folder = tmp_path / "twice"
    render = shard_module.render_frame

    def slow(scenario, index, channels=True):
        if index == 6:  # the other job makes all shards and ends
            shutil.copytree(dataset, folder, dirs_exist_ok=True)
            clear_away(folder)
        return render(scenario, index, channels=channels)

    monkeypatch.setattr(shard_module, "render_frame", slow)
    report = generate(load_scenario(scenario_path), scenario_path.read_text(), folder, SPEC, part=Part(1, 3))
    assert [(one.shard.index, one.complete) for one in report.reports] == [(1, True)]
    assert fingerprint(folder) == fingerprint(dataset)


def test_files_that_another_job_takes_for_leftovers_are_put_again(tmp_path, monkeypatch) -> None:
    sync, struck = os.fsync, []

    def cleared(handle: int) -> None:
        sync(handle)
        if not struck:
            struck.append(handle)
            clear_away(tmp_path / "set")

    monkeypatch.setattr(os, "fsync", cleared)
    (tmp_path / "manifest").write_text("whole")
    LocalTarget(tmp_path / "set").put(tmp_path / "manifest", "manifest.json")
    assert struck
    assert [path.name for path in (tmp_path / "set").iterdir()] == ["manifest.json"]
    assert (tmp_path / "set/manifest.json").read_text() == "whole"


def test_a_temporary_file_that_goes_while_sizes_are_read_is_none(tmp_path, monkeypatch) -> None:
    (tmp_path / "data").mkdir()
    for name in (".shard-000001-x.tar", "shard-000000.tar"):
        (tmp_path / "data" / name).write_text("a")
    listed = Path.rglob

    def renamed_since(folder, pattern):
        found = list(listed(folder, pattern))
        (tmp_path / "data/.shard-000001-x.tar").rename(tmp_path / "data/shard-000001.tar")
        return iter(found)

    monkeypatch.setattr(Path, "rglob", renamed_since)
    monkeypatch.setattr(Path, "is_file", lambda path: True)  # as it was when asked
    assert LocalTarget(tmp_path).sizes("data") == {"data/shard-000000.tar": 1}


def test_two_jobs_that_begin_at_the_same_moment_share_the_dataset(
    dataset, scenario_path, tmp_path, monkeypatch
) -> None:
    """The second looks for the scenario's copy just before the first stores it, and lists the files just after."""
    folder = tmp_path / "together"

    class Late(LocalTarget):
        def listing(self) -> list[str]:
            shutil.copytree(dataset, folder, dirs_exist_ok=True)
            return super().listing()

    monkeypatch.setattr(generate_module, "open_target", lambda out: Late(Path(out)))
    report = generate(load_scenario(scenario_path), scenario_path.read_text(), folder, SPEC)
    assert all(one.skipped for one in report.reports)
    assert fingerprint(folder) == fingerprint(dataset)
