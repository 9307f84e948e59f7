"""Datasets load with other people's tools: pandas, Arrow, DuckDB, WebDataset, Hugging Face, Croissant."""

import duckdb
import pandas as pd
import pyarrow.dataset
import pytest
import yaml
from own_process import in_a_process_of_its_own
from small_scenes import BASE
from tiny_dataset import TINY

from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.dataset.reader import Dataset
from generator.scenario.file import parse_scenario


def test_loads_with_pandas_and_pyarrow(dataset) -> None:
    frames = pd.read_parquet(dataset / "frames" / "train")
    assert len(frames) == 12
    assert frames["bortle"].tolist() == [2] * 4 + [5] * 4 + [8] * 4
    assert frames[["azimuth_deg", "altitude_deg", "roll_deg"]].drop_duplicates().to_numpy().tolist() == [
        [180.0, 90.0, 0.0]
    ]
    stars = pyarrow.dataset.dataset(dataset / "stars" / "train", format="parquet").to_table()
    assert stars.num_rows == frames["n_in_field"].sum()
    assert stars.schema.field("u_px").metadata[b"unit"] == b"px"


def test_loads_with_duckdb(dataset) -> None:
    with duckdb.connect() as connection:
        (count,) = connection.execute(
            f"select count(*) from '{dataset}/frames/train/*.parquet' f join '{dataset}/stars/train/*.parquet' s "
            "on f.index = s.index where s.fraction_in_frame > 0.99"
        ).fetchone()
    assert count > 100


def test_loads_with_webdataset(dataset) -> None:
    code = (
        "import io, json, sys, webdataset, numpy, PIL.Image\n"
        "samples = list(webdataset.WebDataset(sys.argv[1:], shardshuffle=False))\n"
        "print([sample['__key__'] for sample in samples])\n"
        "print(numpy.array(PIL.Image.open(io.BytesIO(samples[0]['png']))).shape)\n"
        "print(json.loads(samples[0]['json'])['frame_id'])\n"
    )
    printed = in_a_process_of_its_own(code, *sorted(str(path) for path in dataset.glob("data/train/*.tar")))
    keys = [f"frame-{index:05d}" for index in range(12)]
    assert printed.splitlines() == [str(keys), "(64, 96)", "frame-00000"]


def test_loads_with_hugging_face_datasets(dataset, tmp_path) -> None:
    code = (
        "import sys, datasets\n"
        "frames = datasets.load_dataset(sys.argv[1], 'frames', split='train')\n"
        "stars = datasets.load_dataset(sys.argv[1], 'stars', split='train')\n"
        "objects = datasets.load_dataset(sys.argv[1], 'objects', split='train')\n"
        "print(len(frames), frames[3]['bortle'], len(stars) > 100, objects[0]['kind'])\n"
    )
    printed = in_a_process_of_its_own(
        code, str(dataset), HF_HOME=str(tmp_path), HF_HUB_OFFLINE="1", HF_DATASETS_OFFLINE="1"
    )
    assert printed.split() == ["12", "2", "True", "satellite"]


# Makes two datasets.
@pytest.mark.journey
def test_hugging_face_datasets_reads_objects_past_shards_without_any(tmp_path) -> None:
    """Of three shards the middle one alone has an object; a set without objects does not offer the table."""
    few = BASE | {
        "camera": {"width": 48, "height": 32, "hfov_deg": 140, "aperture_mm": 4},
        "stars": {"limiting_magnitude": 2.0},
        "foreground": {"trails": {"sweep": [[], TINY["foreground"]["trails"], []]}},
    }
    count = "import sys, datasets; print(len(datasets.load_dataset(sys.argv[1], 'objects', split='train')))"
    offline = {"HF_HOME": str(tmp_path / "home"), "HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"}
    generate(
        parse_scenario(yaml.safe_dump(few), "few.yaml"),
        yaml.safe_dump(few),
        tmp_path / "few",
        DatasetSpec(shard_size=1),
    )
    assert in_a_process_of_its_own(count, str(tmp_path / "few"), **offline).split() == ["1"]
    none = few | {"foreground": {}}
    generate(parse_scenario(yaml.safe_dump(none), "none.yaml"), yaml.safe_dump(none), tmp_path / "none", DatasetSpec())
    assert "config_name: objects" not in (tmp_path / "none/README.md").read_text()
    assert Dataset.open(tmp_path / "none").objects().num_rows == 0


def test_croissant_is_valid_and_yields_records(dataset) -> None:
    code = (
        "import sys, mlcroissant\n"
        "described = mlcroissant.Dataset(jsonld=sys.argv[1])\n"
        "print(len(described.metadata.issues.errors), described.metadata.ctx.conforms_to.value)\n"
        "for table in ('frames', 'stars', 'objects'):\n"
        "    first = next(iter(described.records(table)))\n"
        "    print(first[f'{table}/frame_id'].decode())\n"
    )
    printed = in_a_process_of_its_own(code, str(dataset / "croissant.json"))
    assert printed.splitlines() == ["0 http://mlcommons.org/croissant/1.1", *["frame-00000"] * 3]
