"""A dataset as YOLO: 8-bit images, a text file of boxes for each, and ``data.yaml``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from generator.dataset.reader import Dataset, Frame
from generator.export.annotations import CATEGORIES, annotate
from generator.export.form import ExportOptions, Progress
from generator.files import path_within, write_bytes
from generator.frame.render import png_bytes

SOFTENING = 1e-3
"""Fraction of the sensor's range below which the stretch is linear."""


def export_yolo(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write ``images/SPLIT``, ``labels/SPLIT`` and ``data.yaml`` (https://docs.ultralytics.com/datasets/detect/).

    A line of a label file consists of the category's number from 0, and the box's centre, width and height relative to
    the image's size.
    """
    split = dataset.manifest.split
    for frame in dataset:
        camera = frame.record["camera"]
        write_bytes(path_within(out, f"images/{split}/{frame.frame_id}.png"), png_bytes(stretched(frame)))
        found = annotate(frame, options.annotated_snr)
        size = np.array([camera["width"], camera["height"]], dtype=np.float64)
        middle, extent = (found.box[:, :2] + found.box[:, 2:]) / 2 / size, (found.box[:, 2:] - found.box[:, :2]) / size
        lines = [
            f"{category} {u:.6f} {v:.6f} {width:.6f} {height:.6f}\n"
            for category, (u, v), (width, height) in zip(found.category, middle, extent, strict=True)
        ]
        write_bytes(path_within(out, f"labels/{split}/{frame.frame_id}.txt"), "".join(lines).encode("ascii"))
        progress(frame.frame_id)
    # One dataset is one split; another one for validation is exported into a separate folder.
    described = {"train": f"images/{split}", "val": f"images/{split}", "names": dict(enumerate(CATEGORIES))}
    write_bytes(out / "data.yaml", yaml.safe_dump(described, sort_keys=False).encode())


def stretched(frame: Frame) -> NDArray[np.uint8]:
    """An 8-bit picture of the raw image, (height, width): asinh from the black level to the largest DN.

    The stretch depends only on the sensor, not on the content of the frame. Readers of YOLO data support only 8 bits.
    """
    sensor = frame.record["sensor"]
    black, white = float(sensor["black_level_dn"]), 2.0 ** sensor["bits"] - 1
    share = np.clip((frame.image - black) / (white - black), 0, 1)
    return np.rint(255 * np.arcsinh(share / SOFTENING) / np.arcsinh(1 / SOFTENING)).astype(np.uint8)
