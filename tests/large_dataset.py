"""Datasets of any number of frames, made without rendering: the frames are one small frame under other numbers.

Archives, tables, receipts, card and manifest are those that `skybench generate` writes.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import pyarrow as pa
import pytest
import yaml
from small_scenes import BASE

from generator.dataset import shard as shard_module
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.frame.render import render_frame
from generator.scenario.file import load_scenario

TREE = BASE | {
    "name": "large",
    "camera": BASE["camera"] | {"width": 16, "height": 12},
    "stars": {"limiting_magnitude": 2.0},
}


def write_scenario(folder: Path, frames: int) -> Path:
    """A scenario of so many frames."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "large.yaml"
    path.write_text(yaml.safe_dump(TREE | {"frames": frames}), encoding="utf-8")
    return path


def write_dataset(scenario_path: Path, folder: Path, shard_size: int = 100) -> Path:
    """The dataset of a scenario, its first frame under every number."""
    scenario = load_scenario(scenario_path)
    first = render_frame(scenario, 0, channels=False)

    def numbered(scenario, index, spec, log):
        plan = dataclasses.replace(first.plan, index=index)
        stars = first.stars
        for place, value in enumerate((index, plan.frame_id)):
            field = stars.schema.field(place)
            stars = stars.set_column(place, field, pa.array([value] * stars.num_rows, field.type))
        return dataclasses.replace(first, plan=plan, stars=stars)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shard_module, "_try_frame", numbered)
        text = scenario_path.read_text(encoding="utf-8")
        report = generate(scenario, text, folder, DatasetSpec(shard_size=shard_size))
    assert not report.missing
    return folder


if __name__ == "__main__":
    place = Path(sys.argv[1])
    write_dataset(write_scenario(place, int(sys.argv[2])), place / "set")
