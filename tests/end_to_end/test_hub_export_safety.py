"""`skybench export --to huggingface` of a stranger's dataset, and after a run that was killed."""

import hashlib
import json
import os
import shutil
from pathlib import Path

import pytest
from tiny_dataset import fingerprint

from benchmark.errors import DatasetError
from benchmark.frames.sharded import open_sharded
from generator.dataset.reader import Dataset
from generator.dataset.verify import problems
from generator.errors import GeneratorError
from generator.export import huggingface
from generator.export.export import export

SECRET = b"a secret of the user's\n"


def listing(folder: Path, place: str) -> None:
    """Let the manifest of a dataset list a file, as it is found under its name."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    data = (folder / place).read_bytes()
    manifest["files"] = [file for file in manifest["files"] if file["path"] != place]
    manifest["files"].append({"path": place, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()})
    path.write_text(json.dumps(manifest))


@pytest.fixture
def hostile(small_set, tmp_path) -> Path:
    """A copy of a dataset beside a secret."""
    (tmp_path / "secret").write_bytes(SECRET)
    return Path(shutil.copytree(small_set, tmp_path / "set"))


def published(out: Path) -> set[bytes]:
    return {path.read_bytes() for path in out.rglob("*") if path.is_file()}


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_listed_link_is_neither_followed_nor_published(hostile, tmp_path, kind) -> None:
    place = "notes.txt" if kind == "file" else "docs/secret"
    (hostile / place.split("/")[0]).symlink_to(tmp_path / "secret" if kind == "file" else tmp_path)
    listing(hostile, place)
    export(hostile, "huggingface", tmp_path / "hub")
    assert SECRET not in published(tmp_path / "hub")
    assert any(f"{place}: is a link that leads out" in problem for problem in problems(hostile))


def test_a_scenario_that_is_a_link_is_refused(hostile, tmp_path) -> None:
    (hostile / "scenario.yaml").rename(tmp_path / "elsewhere.yaml")
    (hostile / "scenario.yaml").symlink_to(tmp_path / "elsewhere.yaml")
    with pytest.raises(GeneratorError, match=r"scenario\.yaml: is a link that leads out of"):
        export(hostile, "huggingface", tmp_path / "hub")


def test_only_what_the_scenario_names_is_published(hostile, tmp_path) -> None:
    (hostile / "notes.txt").write_bytes(SECRET)
    listing(hostile, "notes.txt")
    export(hostile, "huggingface", tmp_path / "hub")
    assert {path.name for path in (tmp_path / "hub/recipe/train").iterdir()} == {"scenario.yaml", "manifest.json"}


def test_a_recipe_that_is_not_as_listed_is_refused(hostile, tmp_path) -> None:
    text = (hostile / "scenario.yaml").read_bytes()
    (hostile / "scenario.yaml").write_bytes(text.replace(b"small-set", b"other-set"))
    with pytest.raises(GeneratorError, match=r"scenario\.yaml: its contents have changed"):
        export(hostile, "huggingface", tmp_path / "hub")


def test_readers_follow_no_link_out_of_a_dataset(hostile, tmp_path) -> None:
    path = hostile / "data/train/shard-000000.tar"
    path.rename(tmp_path / "elsewhere.tar")
    path.symlink_to(tmp_path / "elsewhere.tar")
    with pytest.raises(GeneratorError, match=r"shard-000000\.tar: is a link that leads out of"):
        Dataset.open(hostile)[0]
    with pytest.raises(DatasetError, match=r"shard-000000\.tar: is a link that leads out of"):
        open_sharded(str(hostile), tmp_path / "data")
    path.unlink()
    path.symlink_to("inside.tar")
    (tmp_path / "elsewhere.tar").rename(path.with_name("inside.tar"))
    assert Dataset.open(hostile)[0].image.shape == (160, 240)


@pytest.mark.parametrize("stop", ["shutil.copyfile", "write_zenodo", "write_manifest"])
def test_a_killed_export_is_made_whole_by_the_next(small_set, tmp_path, monkeypatch, stop) -> None:
    export(small_set, "huggingface", tmp_path / "whole")
    out = tmp_path / "hub"

    class KilledError(BaseException):
        """Ends a run as a signal does."""

    def killed(*arguments: object) -> None:
        raise KilledError

    with monkeypatch.context() as patched:
        patched.setattr(f"{huggingface.__name__}.{stop}", killed)
        with pytest.raises(KilledError):
            export(small_set, "huggingface", out)
    assert not (out / "recipe/train/manifest.json").exists()
    # What a process leaves that cannot clean up.
    for place in ("frames/.train-00000-of-00002-x.parquet", "frames/train-00004-of-00005.parquet",
                  ".README-x.md", "recipe/train/.scenario-x.yaml"):  # fmt: skip
        (out / place).parent.mkdir(parents=True, exist_ok=True)
        (out / place).write_bytes(b"half")
    export(small_set, "huggingface", out)
    assert fingerprint(out) == fingerprint(tmp_path / "whole")
    assert os.listdir(out / "recipe") == ["train"]
