"""Frames with a landscape: their mask in folders and shards, and the same bytes on any number of workers."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from small_scenes import BASE

from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.dataset.reader import Dataset
from generator.dataset.verify import problems
from generator.frame.render import render_dataset
from generator.scenario.file import load_scenario


def scene(folder: Path) -> Path:
    rgba = np.zeros((90, 360, 4), np.uint8)
    rgba[40:] = (90, 110, 60, 255)
    rgba[20:40, 100:104] = (60, 60, 60, 200)
    Image.fromarray(rgba).save(folder / "hill.png")
    tree = BASE | {"frames": 4, "foreground": {"landscape": {"file": "hill.png", "top_deg": 40, "bottom_deg": -50}}}
    tree |= {"attitude": {"azimuth_deg": 102.0, "altitude_deg": {"uniform": [5, 30]}, "roll_deg": 0.0}}
    (folder / "scene.yaml").write_text(yaml.safe_dump(tree))
    return folder / "scene.yaml"


@pytest.mark.journey
def test_a_dataset_carries_the_mask_and_does_not_depend_on_its_workers(tmp_path) -> None:
    path = scene(tmp_path)
    for name, workers in (("alone", 0), ("together", 2)):
        generate(load_scenario(path), path.read_text(), tmp_path / name, DatasetSpec(shard_size=2), workers=workers)
        assert problems(tmp_path / name) == []
    tars = [sorted((tmp_path / name).glob("data/*/*.tar")) for name in ("alone", "together")]
    assert [each.read_bytes() for each in tars[0]] == [each.read_bytes() for each in tars[1]]
    render_dataset(load_scenario(path), tmp_path / "frames")
    dataset = Dataset.open(tmp_path / "alone")
    for index in range(4):
        with Image.open(tmp_path / "frames" / f"frame-{index:05d}-mask.png") as image:
            folder_mask = np.array(image)
        mask = dataset[index].mask
        assert mask is not None
        np.testing.assert_array_equal(mask, folder_mask)
        assert mask.shape == dataset[index].image.shape
        assert 0.2 < (mask == 255).mean() < 0.95
        assert ((mask > 150) & (mask < 250)).any()


def test_frames_under_an_open_sky_have_no_mask(tmp_path) -> None:
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(BASE))
    render_dataset(load_scenario(tmp_path / "scene.yaml"), tmp_path / "frames")
    assert not list((tmp_path / "frames").glob("*mask*"))
