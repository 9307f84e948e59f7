"""A dataset as a repository of the Hugging Face Hub: Parquet files with images in them, a card, and the recipe.

Images are stored unchanged as 16-bit PNG in a column of the type ``Image``; `datasets` decodes it to a Pillow image of
mode ``I;16``, which NumPy converts to uint16 without loss.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import yaml

from generator.dataset.layout import CARD, IMU, MANIFEST, SCENARIO_COPY, TABLES
from generator.dataset.manifest import Manifest, read_manifest, write_manifest
from generator.dataset.reader import Dataset
from generator.errors import GeneratorError
from generator.export.form import ExportOptions, Progress
from generator.export.plain_files import raw_png
from generator.export.zenodo import ZENODO, write_zenodo
from generator.files import atomic_path, linked_within, path_within, write_bytes
from generator.scenario.file import load_scenario
from generator.stored_files import StoredFile, file_problem

EVAL, RECIPE, TASK_CARD_PREFIX = "eval.yaml", "recipe", "task-"
OWN_NAMES = {CARD, EVAL, ZENODO, RECIPE, IMU, *TABLES, ".git", ".gitattributes"}
"""Allowed contents of a repository in this format; another split is added to the existing ones."""
FRAMES_PER_GROUP = 16
"""Frames per row group: about 25 MB of images of 1080 x 720 pixels in memory at a time."""
IMAGE_FIELDS = [
    pa.field("image", pa.struct([pa.field("bytes", pa.binary()), pa.field("path", pa.string())])),
    pa.field("record", pa.string(), metadata={"unit": ""}),
]
# The key under which `datasets` looks for types that Parquet does not have.
IMAGE_TYPE = {b"huggingface": json.dumps({"info": {"features": {"image": {"_type": "Image"}}}}).encode()}
ROWS = {
    "frames": "frame: `image`, `record` (JSON: camera, attitude, time, site, sensor, sky), and its scalars as columns",
    "stars": "frame and star or planet of the catalogue, seen or not",
    "objects": "frame and satellite, aircraft, meteor, Moon or cosmic ray",
    IMU: "reading of the inertial unit of a sequence",
}
"""Meaning of a row in each configuration."""
SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))


def export_huggingface(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write a split, and the card of all splits in the folder.

    The manifest in the split's recipe is written last and marks the split as complete; remains of a killed run are replaced.

    Raises
    ------
    GeneratorError
        The folder contains other files, or already this split.
    """
    del options
    split = dataset.manifest.split
    recipe = out / RECIPE / split
    unfinished = {path for place in (CARD, ZENODO) for path in out.glob(f".{Path(place).stem}-*{Path(place).suffix}")}
    names = {path.name for path in set(out.iterdir()) - unfinished if not path.name.startswith(TASK_CARD_PREFIX)}
    strangers = sorted(names - OWN_NAMES)
    if strangers:
        raise GeneratorError(f"{out}: holds other files ({strangers[0]}, …); choose an empty folder")
    if (recipe / MANIFEST).exists():
        raise GeneratorError(f"{out}: has the split '{split}' already; choose another folder, or generate with --split")
    for path in (*unfinished, *_leftovers(out, split)):
        path.unlink()
    paths = dataset.paths("data")
    for number, path in enumerate(paths):
        part = f"{split}-{number:05d}-of-{len(paths):05d}.parquet"
        _write_frames(dataset, path.stem, out / "frames" / part, progress)
    for table in (*TABLES[1:], IMU):
        rows = dataset.table(table)
        # The package `datasets` refuses a table without any row.
        if rows.num_rows:
            with atomic_path(out / table / f"{split}-00000-of-00001.parquet") as temporary:
                pq.write_table(rows, temporary, compression="zstd")
    _keep_recipe(dataset, recipe)
    others = [read_manifest(path.parent) for path in (out / RECIPE).glob(f"*/{MANIFEST}")]
    manifests = sorted((dataset.manifest, *others), key=lambda manifest: manifest.split)
    write_bytes(out / CARD, card(out, manifests).encode())
    write_zenodo(out, manifests)
    write_manifest(recipe, dataset.manifest)


def _leftovers(out: Path, split: str) -> list[Path]:
    """Remains of an incomplete split after a killed run: its parts, and files under temporary names."""
    found = [path for path in (out / RECIPE / split).rglob(".*-*") if path.is_file()]
    for table in (*TABLES, IMU):
        found += (out / table).glob(f"{split}-?????-of-?????.parquet")
        found += (out / table).glob(f".{split}-*.parquet")
    return found


def _write_frames(dataset: Dataset, stem: str, path: Path, progress: Progress) -> None:
    """Write the frames of a shard: image, record, and the columns of the table of frames."""
    table = dataset.frames()
    rows = table.filter(pc.equal(table["shard"], stem)).drop_columns(["image", "shard"])
    schema = pa.schema([*IMAGE_FIELDS, *rows.schema], metadata=IMAGE_TYPE)
    with atomic_path(path) as temporary, pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
        for first, images, records in _groups(dataset, stem, progress):
            columns = [
                pa.array(images, type=schema.field("image").type),
                pa.array(records, type=pa.string()),
                *rows.slice(first, len(images)).combine_chunks().columns,
            ]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))


def _groups(dataset: Dataset, stem: str, progress: Progress) -> Iterator[tuple[int, list[dict[str, Any]], list[str]]]:
    """Yield images and records of a shard in groups, each with the index of its first frame."""
    images: list[dict[str, Any]] = []
    records: list[str] = []
    first = 0
    for frame in dataset.shard(stem):
        images.append({"bytes": raw_png(frame), "path": f"{frame.frame_id}.png"})
        records.append(json.dumps(frame.record))
        progress(frame.frame_id)
        if len(images) == FRAMES_PER_GROUP:
            yield first, images, records
            first, images, records = first + len(images), [], []
    if images:
        yield first, images, records


def _keep_recipe(dataset: Dataset, folder: Path) -> None:
    """Copy the scenario and the files that it names; other files in a third party's manifest are not published.

    Raises
    ------
    GeneratorError
        One of them is not listed, differs from the list, or is a link that leads out of the dataset.
    """
    listed = {file.path: file for file in dataset.manifest.files}
    _copy(dataset, listed, SCENARIO_COPY, folder)
    for file in load_scenario(dataset.folder / SCENARIO_COPY).files:
        _copy(dataset, listed, file.path, folder)


def _copy(dataset: Dataset, listed: Mapping[str, StoredFile], place: str, folder: Path) -> None:
    """Copy a file of the recipe after comparing it with the manifest."""
    if place not in listed:
        raise GeneratorError(f"{dataset.folder}: the manifest does not list {place}; run `skybench verify`")
    if problem := file_problem(dataset.folder, listed[place]):
        raise GeneratorError(f"{dataset.folder}: {problem}; run `skybench verify`")
    with atomic_path(path_within(folder, place)) as temporary:
        shutil.copyfile(linked_within(dataset.folder, place), temporary)


def card(out: Path, manifests: list[Manifest]) -> str:
    """The card of a repository: YAML for the Hub, text for people."""
    counts = [manifest.stop - manifest.first for manifest in manifests]
    configs = [
        {
            "config_name": table,
            "data_files": [
                {"split": manifest.split, "path": f"{table}/{manifest.split}-*.parquet"}
                for manifest in manifests
                if list((out / table).glob(f"{manifest.split}-*.parquet"))
            ],
        }
        for table in (*TABLES, IMU)
    ]
    names = ", ".join(sorted({" ".join(manifest.scenario.split()) for manifest in manifests}))
    front = {
        "license": "cc-by-4.0",
        "pretty_name": names,
        "task_categories": ["other"],
        "size_categories": [next((name for most, name in SIZES if sum(counts) < most), "n>1M")],
        "tags": ["astronomy", "star-identification", "celestial-navigation", "synthetic", "image"],
        "configs": [
            config | ({"default": True} if config["config_name"] == TABLES[0] else {})
            for config in configs
            if config["data_files"]
        ],
    }
    tables = "".join(f"| `{name}` | {rows} |\n" for name, rows in ROWS.items() if (out / name).is_dir())
    splits = "".join(
        f"| `{each.split}` | {count} | {' '.join(each.scenario.split())} | `{each.scenario_sha256}` | "
        f"`skybench generate {RECIPE}/{each.split}/{SCENARIO_COPY} --out DIR "
        f"--split {each.split} --frames {each.first}:{each.stop}` |\n"
        for each, count in zip(manifests, counts, strict=True)
    )
    return f"""---
{yaml.safe_dump(front, sort_keys=False).strip()}
---

# {names}

Synthetic frames of the night sky with the truth about every star, planet, satellite, aircraft, meteor, cosmic ray and the
Moon, rendered by skybench {manifests[0].skybench}. Images are 16-bit raw sensor values.

| split | frames | scenario | SHA-256 | recipe |
|---|---|---|---|---|
{splits}
With the same version of skybench a recipe gives the same frames again, bit for bit.

```python
import datasets
import numpy as np

frames = datasets.load_dataset("REPOSITORY", "frames", split="{manifests[0].split}")
image = np.asarray(frames[0]["image"])  # uint16, (height, width)
stars = datasets.load_dataset("REPOSITORY", "stars", split="{manifests[0].split}").to_pandas()
stars = stars[(stars["index"] == frames[0]["index"]) & (stars["snr"] >= 5)]  # what can be seen
```

| configuration | one row per |
|---|---|
{tables}
Columns, units and conventions: docs/dataset_format.md and docs/conventions.md of skybench. Pixel centres are at integers; u
runs to the right, v down.

## Limits

The frames are synthetic; docs/physics.md of skybench lists each model with its source and limits.
"""
