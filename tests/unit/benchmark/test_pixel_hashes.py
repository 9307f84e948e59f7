"""Images are decoded once for their hash; a list of hashes that is damaged, stale or missing changes no hash."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from unit.benchmark.fake_night import write_dataset

from benchmark.errors import DatasetError
from benchmark.frames import pixel_hashes
from benchmark.frames.dataset import load_image, open_dataset
from benchmark.frames.pixel_hashes import image_sha256
from generator.identity.pixels import pixels_sha256


@pytest.fixture
def frames(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return open_dataset(write_dataset(tmp_path / "night", (1,), per_class=3)).frames


@pytest.fixture
def place(frames, tmp_path):
    return tmp_path / "cache" / "skybench" / "pixel_hashes.txt"


def forget():
    """What a new process does."""
    pixel_hashes._read.cache_clear()


def count_decoded(monkeypatch):
    decoded = []

    def seen(frame):
        decoded.append(frame.frame_id)
        return load_image(frame)

    monkeypatch.setattr(pixel_hashes, "load_image", seen)
    return decoded


def test_each_image_is_decoded_once_by_all_processes(frames, monkeypatch):
    decoded = count_decoded(monkeypatch)
    first = [image_sha256(frame) for frame in frames]
    forget()
    assert [image_sha256(frame) for frame in frames] == first
    assert first == [pixels_sha256(load_image(frame)) for frame in frames]
    assert decoded == [frame.frame_id for frame in frames]


def test_a_changed_image_has_another_hash_and_a_repacked_one_the_same(frames):
    path, before = frames[0].image_path, image_sha256(frames[0])
    image = load_image(frames[0])
    old = path.read_bytes()
    Image.fromarray(image).save(path, compress_level=0)
    assert path.read_bytes() != old
    assert image_sha256(frames[0]) == before
    image[3, 4] ^= 1
    Image.fromarray(image).save(path)
    assert image_sha256(frames[0]) == pixels_sha256(image) != before


def test_a_known_file_with_a_camera_of_another_size_is_still_refused(frames):
    image_sha256(frames[0])
    camera = frames[0].observation.camera
    other = np.zeros((camera.height, camera.width + 1), np.uint16)
    Image.fromarray(other).save(frames[0].image_path)
    with pytest.raises(DatasetError, match="the two must agree"):
        image_sha256(frames[0])
    frames[0].image_path.unlink()
    with pytest.raises(DatasetError, match="missing image"):
        image_sha256(frames[0])


@pytest.mark.parametrize("damage", [b"\xff\xfe\n", b"a" * 64 + b":9x9", b"..\n", b"0" * 64 + b":1x1 beef\n"])
def test_lines_of_another_form_are_ignored(frames, place, damage, monkeypatch):
    truth = [image_sha256(frame) for frame in frames]
    lines = place.read_bytes().splitlines(keepends=True)
    place.write_bytes(lines[0] + damage + lines[2])
    forget()
    decoded = count_decoded(monkeypatch)
    assert [image_sha256(frame) for frame in frames] == truth
    assert "frame-00001" in decoded
    assert "frame-00000" not in decoded


def test_a_list_that_has_grown_too_large_is_begun_anew(frames, place, monkeypatch):
    truth = image_sha256(frames[0])
    monkeypatch.setattr(pixel_hashes, "LARGEST_FILE_BYTES", place.stat().st_size - 1)
    forget()
    assert image_sha256(frames[0]) == truth
    assert len(place.read_text().splitlines()) == 1


def test_without_a_home_every_image_is_decoded(frames, monkeypatch):
    def no_home():
        raise RuntimeError("there is no home folder")

    monkeypatch.setattr(pixel_hashes, "cache_dir", no_home)
    decoded = count_decoded(monkeypatch)
    assert image_sha256(frames[0]) == image_sha256(frames[0]) == pixels_sha256(load_image(frames[0]))
    assert len(decoded) == 2


def test_a_cache_that_cannot_be_written_costs_time_alone(frames, place):
    place.parent.parent.mkdir(parents=True)
    place.parent.write_text("no folder")
    assert image_sha256(frames[0]) == pixels_sha256(load_image(frames[0]))
