"""Folders that hold the truth of a frame, which no solver may read."""

from __future__ import annotations

from pathlib import Path

from benchmark.frames.dataset import Frame
from benchmark.frames.task_frames import UNPACKED


def truth_folders(frame: Frame) -> list[Path]:
    """Folders with a frame's image, its record and the tables of its stars, each with all that lies below it."""
    image = frame.image_path.parent
    record = image if frame.record_path is None else frame.record_path.parent
    # The tables of stars of unpacked frames lie beside the folder of their images and records.
    return list(dict.fromkeys(place.parent if place.name == UNPACKED else place for place in (image, record)))
