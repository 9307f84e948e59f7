"""A dataset as plain files: images as PNG, every other member of the shards unchanged, each table as one Parquet file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from generator.dataset.layout import CODECS, IMU, TABLES
from generator.dataset.reader import Dataset, ShardFrame
from generator.export.form import ExportOptions, Progress
from generator.files import atomic_path, path_within, write_bytes
from generator.frame.render import png_bytes


def export_files(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write images as 16-bit PNG, every other member of the shards unchanged, and each table as one Parquet file."""
    del options
    images: dict[str, tuple[str, str]] = {}
    for frame in dataset:
        place, image = f"{frame.frame_id}.png", raw_png(frame)
        images[frame.frame_id] = place, hashlib.sha256(image).hexdigest()
        write_bytes(path_within(out, place), image)
        for suffix in sorted(frame.members.keys() - set(CODECS)):
            write_bytes(path_within(out, f"{frame.frame_id}.{suffix}"), frame.file(suffix))
        progress(frame.frame_id)
    for name in (*TABLES, *([IMU] if dataset.paths(IMU) else [])):
        table = dataset.table(name)
        with atomic_path(path_within(out, f"{name}.parquet")) as temporary:
            pq.write_table(_naming(images, table) if name == "frames" else table, temporary)


def _naming(images: Mapping[str, tuple[str, str]], frames: pa.Table) -> pa.Table:
    """The table of frames with the names and hashes of the images as written."""
    written = [images[frame_id] for frame_id in frames["frame_id"].to_pylist()]
    for column, values in zip(("image", "image_sha256"), zip(*written, strict=True), strict=True):
        number = frames.schema.get_field_index(column)
        frames = frames.set_column(number, frames.schema.field(number), pa.array(values, frames.schema.types[number]))
    return frames


def raw_png(frame: ShardFrame) -> bytes:
    """The raw image as a 16-bit PNG, regardless of its stored codec."""
    return frame.file("png") if "png" in frame.members else png_bytes(frame.image)
