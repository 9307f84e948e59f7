"""A dataset as plain files: every member of the shards, and each table as one Parquet file."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq

from generator.dataset.layout import IMU, TABLES
from generator.dataset.reader import Dataset, ShardFrame
from generator.export.form import ExportOptions, Progress
from generator.files import atomic_path, path_within, write_bytes
from generator.frame.render import png_bytes


def export_files(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write every member of the shards as a file, and each table as one Parquet file."""
    del options
    for frame in dataset:
        for suffix in frame.members:
            write_bytes(path_within(out, f"{frame.frame_id}.{suffix}"), frame.file(suffix))
        progress(frame.frame_id)
    for name in (*TABLES, *([IMU] if dataset.paths(IMU) else [])):
        with atomic_path(path_within(out, f"{name}.parquet")) as temporary:
            pq.write_table(dataset.table(name), temporary)


def raw_png(frame: ShardFrame) -> bytes:
    """The raw image as a 16-bit PNG, whatever codec it is stored with."""
    return frame.file("png") if "png" in frame.members else png_bytes(frame.image)
