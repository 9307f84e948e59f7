"""Datasets to be shared: a repository for the Hugging Face Hub with several splits, tasks in it, and Zenodo's metadata."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import TaskError
from benchmark.tasks.definition import load_task
from benchmark.tasks.hub import TaskSplit, task_of, write_eval
from generator.dataset.manifest import Manifest, read_manifest
from generator.errors import GeneratorError
from generator.export.export import export


@pytest.fixture(scope="module")
def another_split(small_set, tmp_path_factory) -> Path:
    """The same frames under the name of another split."""
    folder = tmp_path_factory.mktemp("split") / "set"
    shutil.copytree(small_set, folder)
    for table in ("data", "frames", "stars", "objects"):
        (folder / table / "train").rename(folder / table / "test")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["split"] = "test"
    for file in manifest["files"]:
        file["path"] = file["path"].replace("/train/", "/test/")
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def test_splits_lie_beside_each_other(small_set, another_split, tmp_path) -> None:
    out = tmp_path / "hub"
    export(small_set, "huggingface", out)
    with pytest.raises(GeneratorError, match="has the split 'train' already"):
        export(small_set, "huggingface", out)
    export(another_split, "huggingface", out)
    front = yaml.safe_load((out / "README.md").read_text().split("---\n")[1])
    assert [config["config_name"] for config in front["configs"]] == ["frames", "stars", "objects"]
    for config in front["configs"]:
        assert [entry["split"] for entry in config["data_files"]] == ["test", "train"]
        for entry in config["data_files"]:
            assert list(out.glob(entry["path"]))
    zenodo = json.loads((out / ".zenodo.json").read_text())
    assert (zenodo["upload_type"], zenodo["license"]) == ("dataset", "cc-by-4.0")
    assert read_manifest(small_set).scenario_sha256 in zenodo["description"]
    assert (out / "recipe/train/scenario.yaml").read_bytes() == (small_set / "scenario.yaml").read_bytes()
    (out / "notes.txt").write_text("")
    with pytest.raises(GeneratorError, match=r"holds other files \(notes\.txt"):
        export(small_set, "huggingface", out)


def test_a_split_s_name_cannot_lead_out_of_the_folder(small_set, tmp_path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(small_set, folder)
    manifest = json.loads((folder / "manifest.json").read_text()) | {"split": "../../victim"}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(GeneratorError, match="use letters, digits and _"):
        export(folder, "huggingface", tmp_path / "hub")


def of_task(manifest: Manifest, name: str, split: str, stop: int | None = None) -> Manifest:
    scenario = load_task(name).scenario_of(split)
    return dataclasses.replace(
        manifest, scenario_sha256=scenario.sha256, first=0, stop=stop or scenario.frame_count, split="test"
    )


def test_a_dataset_of_a_task_is_known(small_set) -> None:
    manifest = read_manifest(small_set)
    assert task_of(manifest) is None
    assert task_of(of_task(manifest, "bortle", "dev", stop=3)) is None
    found = task_of(of_task(manifest, "motion", "test"))
    assert (found.task.label, found.split) == ("motion@2", "test")


def test_tasks_of_a_repository(tmp_path) -> None:
    """The keys are those of the Hub's specification; a second split is a second task."""
    for split in ("test", "dev", "test"):
        write_eval(tmp_path, TaskSplit(load_task("bortle"), split), split)
    content = yaml.safe_load((tmp_path / "eval.yaml").read_text())
    assert set(content) == {"name", "description", "evaluation_framework", "tasks"}
    assert content["tasks"] == [
        {"id": "bortle-2-dev", "config": "frames", "split": "dev"},
        {"id": "bortle-2-test", "config": "frames", "split": "test"},
    ]
    assert (tmp_path / "task-bortle.md").read_text().startswith("## bortle@2")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a: &a [x]\nb: *a\n", "aliases"),
        ("[" * 9000, "nested too deep"),
        ("a: [}", "cannot be read"),
        ("tasks: 5\n", "a list"),
    ],
)
def test_a_list_of_tasks_that_cannot_be_read_is_not_replaced(tmp_path, content, words) -> None:
    (tmp_path / "eval.yaml").write_text(content)
    with pytest.raises(TaskError, match=rf"eval\.yaml: .*{words}"):
        write_eval(tmp_path, TaskSplit(load_task("bortle"), "test"), "test")
    assert (tmp_path / "eval.yaml").read_text() == content


def test_the_command_adds_the_task_of_a_dataset(small_set, tmp_path, monkeypatch) -> None:
    """The small set stands for a whole split, which takes long to render."""
    monkeypatch.setattr("benchmark.tasks.hub.task_of", lambda manifest: TaskSplit(load_task("bortle"), "test"))
    out = tmp_path / "hub"
    result = CliRunner().invoke(app, ["export", str(small_set), "--to", "huggingface", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert yaml.safe_load((out / "eval.yaml").read_text())["tasks"][0]["split"] == "train"
    assert (out / "task-bortle.md").is_file()
