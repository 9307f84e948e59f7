"""Reading a dataset back: by place, in order, one shard alone, from a URL, in other processes; damage is named."""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from generator.dataset.images import encode
from generator.dataset.reader import Dataset, Frame, decode_member, read_shard
from generator.errors import GeneratorError


def test_a_frame_has_its_image_as_stored_and_its_own_truth(small_set) -> None:
    dataset = Dataset.open(small_set)
    assert len(dataset) == 2
    for position, streamed in enumerate(dataset):
        frame = dataset[position]
        assert (frame.frame_id, frame.index) == (f"frame-{position:05d}", position)
        assert (frame.image.dtype, frame.image.shape) == (np.uint16, (160, 240))
        np.testing.assert_array_equal(frame.image, streamed.image)
        assert frame.image.max() > 255
        assert frame.record["camera"]["width"] == 240
        assert decode_member("json", frame.members["json"]) == frame.record
        assert frame.stars["index"].unique().to_pylist() == [position]
        assert frame.stars.num_rows == frame.record["stars"]["n_in_field"]
        assert frame.stars.equals(streamed.stars)
        assert "moon" in frame.objects["kind"].to_pylist()
        assert (frame.developed, frame.hud) == (None, None)
    assert dataset[-1].frame_id == "frame-00001"
    with pytest.raises(IndexError):
        dataset[2]


def brightness(frame: Frame) -> float:
    return float(frame.image.mean())


def test_a_mapped_dataset_is_made_when_asked_for_and_survives_a_pickle(small_set) -> None:
    """As workers of a loader receive it."""
    mapped = pickle.loads(pickle.dumps(Dataset.open(small_set).map(brightness)))
    assert len(mapped) == 2
    assert mapped[1] == brightness(Dataset.open(small_set)[1])


def test_one_shard_by_itself(small_set, tmp_path) -> None:
    path = tmp_path / "alone.tar"
    shutil.copy(small_set / "data/train/shard-000001.tar", path)
    (frame,) = read_shard(path)
    np.testing.assert_array_equal(frame.image, Dataset.open(small_set)[1].image)
    assert frame.record["index"] == 1


def test_a_url_is_fetched_file_by_file_and_checked(small_set, tmp_path) -> None:
    fsspec = pytest.importorskip("fsspec", reason="fsspec is not installed: pip install 'skybench[cluster]'")
    store = fsspec.filesystem("memory")
    store.put(str(small_set), "/reader-set", recursive=True)
    try:
        dataset = Dataset.open("memory://reader-set", cache=tmp_path)
        np.testing.assert_array_equal(dataset[1].image, Dataset.open(small_set)[1].image)
        assert not list(tmp_path.rglob("data/train/shard-000000.tar"))
        store.pipe("/reader-set/data/train/shard-000000.tar", b"no archive")
        with pytest.raises(GeneratorError, match="is not what its manifest says"):
            dataset[0]
    finally:
        store.rm("/reader-set", recursive=True)
    with pytest.raises(GeneratorError, match="missing"):
        Dataset.open("memory://reader-set", cache=tmp_path)


def test_members_by_suffix() -> None:
    import io

    stream = io.BytesIO()
    Image.fromarray(np.arange(12, dtype=np.uint8).reshape(2, 2, 3)).save(stream, format="PNG")
    developed = decode_member(".developed.png", stream.getvalue())
    assert (developed.dtype, developed.shape) == (np.uint8, (2, 2, 3))
    with pytest.raises(GeneratorError, match="this version reads"):
        decode_member("json", b'{"a": 1}')
    assert decode_member(".exr", b"x") is None


def test_damage_is_named(small_set, tmp_path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(small_set, folder)
    path = folder / "data/train/shard-000000.tar"
    content = bytearray(path.read_bytes())
    start = content.index(b"\x89PNG") + 60
    content[start : start + 200] = bytes(200)
    path.write_bytes(content)
    with pytest.raises(GeneratorError, match=r"shard-000000\.tar: frame-00000 is damaged"):
        _ = Dataset.open(folder)[0].image
    shutil.rmtree(folder / "stars")
    with pytest.raises(GeneratorError, match=r"stars/train/shard-000001\.parquet: No such file"):
        _ = Dataset.open(folder)[1].stars


def test_a_manifest_cannot_lead_out_of_the_folder(small_set, tmp_path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(small_set, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"][0]["path"] = "data/../../victim"
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(GeneratorError, match="could lie outside the folder"):
        Dataset.open(folder)


def test_a_jpeg_xl_dataset_reads_the_same(small_set, tmp_path) -> None:
    """The codec shows in the suffix alone."""
    image = Dataset.open(small_set)[0].image
    np.testing.assert_array_equal(decode_member("jxl", encode(image, "jxl")), image)


def test_paths_and_tables(small_set) -> None:
    dataset = Dataset.open(Path(small_set))
    assert [path.name for path in dataset.paths("data")] == ["shard-000000.tar", "shard-000001.tar"]
    assert dataset.table("frames").num_rows == 2
