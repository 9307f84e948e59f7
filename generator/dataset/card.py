"""The dataset card: a README with the recipe, figures of the set, and its limits."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from generator import __version__
from generator.dataset.archive import read_member
from generator.dataset.images import decode
from generator.dataset.layout import CARD, FIGURES, IMU, SCENARIO_COPY, DatasetSpec, Shard
from generator.dataset.target import Target
from generator.files import write_bytes
from generator.frame.pictures import contact_sheet
from generator.frame.record import VISIBLE_SNR
from generator.scenario.file import Scenario

if TYPE_CHECKING:
    import pandas as pd

SHEET = f"{FIGURES}/contact-sheet.png"
HISTOGRAMS = f"{FIGURES}/histograms.svg"
FRAMES_ON_SHEET = 12

_MARKUP = re.compile(r"[\\`*_{}\[\]<>#+!|~&]")
_HISTOGRAMS = (
    ("latitude_deg", "latitude, deg"),
    ("longitude_deg", "longitude, deg"),
    ("exposure_s", "exposure, s"),
    ("zenith_mag_arcsec2", "zenith, V mag/arcsec²"),
    ("limiting_magnitude", "faintest star drawn, V"),
    ("n_visible", "stars with SNR ≥ 5"),
    ("n_in_field", "catalogue rows"),
)


def write_card(
    folder: Path, scenario: Scenario, spec: DatasetSpec, shards: list[Shard], target: Target, scratch: Path
) -> list[str]:
    """Write README.md and its figures; return the figures' paths from the dataset's root.

    Parameters
    ----------
    folder : Path
        Where to write.
    scenario : Scenario
    spec : DatasetSpec
    shards : list of Shard
        All shards of the dataset.
    target : Target
        Place of the dataset. Only the footers of its tables of stars and objects are read.
    scratch : Path
        Folder for archives of an object store from which pictures are taken, at most FRAMES_ON_SHEET of them.
    """
    import pandas as pd

    frames = pd.concat([_frames(target, shard) for shard in shards], ignore_index=True)
    counts = {
        "stars": sum(_row_count(target, shard.stars) for shard in shards),
        "objects": sum(_row_count(target, shard.objects) for shard in shards),
    }
    (folder / FIGURES).mkdir(exist_ok=True)
    sheet = io.BytesIO()
    contact_sheet(_samples(shards, frames, target, scratch)).save(sheet, format="PNG", optimize=True)
    write_bytes(folder / SHEET, sheet.getvalue())
    write_bytes(folder / HISTOGRAMS, histograms(frames).encode())
    text = card_text(scenario, spec, shards[0].first, shards[-1].stop, frames, counts)
    write_bytes(folder / CARD, text.encode())
    return [SHEET, HISTOGRAMS]


def _frames(target: Target, shard: Shard) -> pd.DataFrame:
    with target.open(shard.frames) as stream:
        return pq.read_table(stream).to_pandas()


def _row_count(target: Target, place: str) -> int:
    with target.open(place) as stream:
        return int(pq.ParquetFile(stream).metadata.num_rows)


def _samples(shards: list[Shard], frames: pd.DataFrame, target: Target, scratch: Path) -> list[NDArray[np.uint16]]:
    """Images of frames spread evenly over the dataset."""
    rows = np.unique(np.linspace(0, len(frames) - 1, min(FRAMES_ON_SHEET, len(frames))).round().astype(int))
    archives = {shard.stem: shard.tar for shard in shards}
    pictures = []
    for row in rows:
        frame = frames.iloc[row]
        image = read_member(target.fetch(archives[frame["shard"]], scratch), frame["image"])
        pictures.append(decode(image, Path(frame["image"]).suffix[1:], (frame["height_px"], frame["width_px"])))
    return pictures


def histograms(frames: pd.DataFrame) -> str:
    """SVG of the distributions of a dataset's main conditions; columns without spread are left out."""
    # Matplotlib is loaded only if something is drawn.
    from generator.drawing.histograms import draw_histograms

    varying = [(title, frames[column].dropna()) for column, title in _HISTOGRAMS if frames[column].nunique() > 1]
    return draw_histograms([(title, values.to_numpy(np.float64)) for title, values in varying], "frames")


def _plain_words(text: str) -> str:
    """Convert a scenario's text to one paragraph of Markdown without markup or HTML."""
    return _MARKUP.sub(r"\\\g<0>", " ".join(text.split()))


def card_text(
    scenario: Scenario, spec: DatasetSpec, first: int, stop: int, frames: pd.DataFrame, counts: dict[str, int]
) -> str:
    """Markdown of the card; `counts` are the numbers of rows of the tables of stars and objects."""
    conditions = "\n".join(
        f"| {title} | {frames[column].min():.4g} | {frames[column].median():.4g} | {frames[column].max():.4g} |"
        for column, title in _HISTOGRAMS
        if frames[column].notna().any()
    )
    flying = "satellites, aircraft, meteors, the Moon and cosmic rays"
    objects = f", {counts['objects']} of {flying}" if counts["objects"] else ""
    # The package `datasets` refuses a table without any row.
    listed_objects = (
        ""
        if not counts["objects"]
        else (
            f"- config_name: objects\n  data_files: [{{split: {spec.split}, path: objects/{spec.split}/*.parquet}}]\n"
        )
    )
    listed_imu, imu_row = "", ""
    if scenario.has_imu:
        listed_imu = (
            f"- config_name: {IMU}\n  data_files: [{{split: {spec.split}, path: {IMU}/{spec.split}/*.parquet}}]\n"
        )
        imu_row = (
            f"| `{IMU}/{spec.split}/*.parquet` | readings and truth of the inertial unit, one file per sequence |\n"
        )
    electrons = ", `.exr` (expected electrons)" if spec.exr else ""
    options = f"--split {spec.split} --shard-size {spec.shard_size}" + (" --exr" if spec.exr else "")
    options += f" --codec {spec.codec}" if spec.codec != "png" else ""
    options += f" --frames {first}:{stop}" if (first, stop) != (0, scenario.frame_count) else ""
    return f"""---
license: cc-by-4.0
task_categories: [other]
tags: [astronomy, star-identification, celestial-navigation, synthetic]
configs:
- config_name: frames
  data_files: [{{split: {spec.split}, path: frames/{spec.split}/*.parquet}}]
- config_name: stars
  data_files: [{{split: {spec.split}, path: stars/{spec.split}/*.parquet}}]
{listed_objects}{listed_imu}---

# {scenario.name}

{_plain_words(scenario.description) or "Synthetic night-sky frames."}

{stop - first} frames with {frames["n_visible"].sum()} stars and planets of SNR ≥ {VISIBLE_SNR:g}, among
{counts["stars"]} rows of the catalogue{objects}, rendered by skybench {__version__}.

![Frames spread over the dataset]({SHEET})

## Make it again

```
skybench generate {SCENARIO_COPY} --out DIR {options}
```

gives the same bytes (scenario SHA-256 `{scenario.sha256}`, seed {scenario.seed}). `skybench verify DIR` checks them.

## What is in it

| condition | least | median | greatest |
|---|---|---|---|
{conditions}

![Distributions of conditions]({HISTOGRAMS})

| file | holds |
|---|---|
| `data/{spec.split}/shard-*.tar` | WebDataset: `frame-NNNNN.{spec.codec}` (16-bit DN), `.json` (frame record){electrons} |
| `frames/{spec.split}/*.parquet` | one row per frame |
| `stars/{spec.split}/*.parquet` | one row per frame and star or planet |
| `objects/{spec.split}/*.parquet` | one row per frame and satellite, aircraft, meteor, Moon or cosmic ray |
{imu_row}| `manifest.json` | every file with its size and SHA-256 |
| `croissant.json` | Croissant 1.1 |
| `{SCENARIO_COPY}` | the recipe |
{_inputs(scenario)}
Columns and units: docs/dataset_format.md of skybench; units also stand in the Parquet schema.

## Limits

The frames are synthetic. Each physical model with its source and limits is listed in docs/physics.md of skybench. The
catalogue is complete to V 7 (90 % at V 8).
"""


def _inputs(scenario: Scenario) -> str:
    """Rows of the card for the files that the scenario names."""
    return "".join(f"| `{file.path}` | named by {SCENARIO_COPY} |\n" for file in scenario.files)
