"""A dataset as COCO: 16-bit PNG images and ``annotations.json`` with boxes, outlines and keypoints."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, TextIO

from generator.dataset.reader import Dataset, Frame
from generator.export.annotations import CATEGORIES, annotate, area_px, outlines
from generator.export.form import ExportOptions, Progress
from generator.export.plain_files import raw_png
from generator.files import atomic_path, path_within, write_bytes

VISIBLE = 2
"""COCO's flag for a keypoint that is labelled and visible."""
DECIMALS = 3
"""Decimals of positions in px."""


def export_coco(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write images and annotations (https://cocodataset.org/#format-data).

    COCO measures from the image's corner, half a pixel left of and above the first pixel's centre.
    """
    images: list[dict[str, Any]] = []
    count = 0
    with atomic_path(out / "annotations.json") as temporary, temporary.open("w", encoding="utf-8") as stream:
        stream.write('{"annotations": [')
        for frame in dataset:
            write_bytes(path_within(out, f"{frame.frame_id}.png"), raw_png(frame))
            camera = frame.record["camera"]
            images.append(
                {
                    "id": frame.index,
                    "file_name": f"{frame.frame_id}.png",
                    "width": camera["width"],
                    "height": camera["height"],
                    "date_captured": frame.record["time"]["utc_start"],
                    "license": 1,
                }
            )
            count = _write_annotations(stream, frame, options.annotated_snr, count)
            progress(frame.frame_id)
        described = {
            "info": {
                "description": f"{dataset.manifest.scenario}, sources with SNR >= {options.annotated_snr:g}",
                "version": dataset.manifest.skybench,
            },
            "licenses": [{"id": 1, "name": "CC BY 4.0", "url": "https://creativecommons.org/licenses/by/4.0/"}],
            "categories": [
                {"id": number, "name": name, "keypoints": ["centre"], "skeleton": []}
                for number, name in enumerate(CATEGORIES, start=1)
            ],
            "images": images,
        }
        stream.write(f"\n], {json.dumps(described)[1:]}\n")


def _write_annotations(stream: TextIO, frame: Frame, least_snr: float, count: int) -> int:
    """Write a frame's annotations, numbered from `count` + 1, one per line; return the last number."""
    camera = frame.record["camera"]
    found = annotate(frame, least_snr)
    for row, outline in enumerate(outlines(found, camera["width"], camera["height"])):
        left, top, right, bottom = found.box[row].tolist()
        u, v = found.centre[row].tolist()
        inside = left <= u <= right and top <= v <= bottom
        annotation = {
            "id": count + 1,
            "image_id": frame.index,
            "category_id": int(found.category[row]) + 1,
            "bbox": _rounded([left, top, right - left, bottom - top]),
            "segmentation": [_rounded(outline.ravel().tolist())],
            "area": round(area_px(outline), DECIMALS),
            "iscrowd": 0,
            "keypoints": [*_rounded([u, v]), VISIBLE] if inside else [0, 0, 0],
            "num_keypoints": int(inside),
            "snr": round(float(found.snr[row]), 2),
            "saturated": bool(found.saturated[row]),
        }
        if math.isfinite(found.v_mag[row]):
            annotation["v_mag"] = round(float(found.v_mag[row]), 3)
        if found.star_id[row]:
            annotation["star_id"] = int(found.star_id[row])
        stream.write(("," if count else "") + "\n" + json.dumps(annotation, allow_nan=False))
        count += 1
    return count


def _rounded(values: list[float]) -> list[float]:
    return [round(value, DECIMALS) for value in values]
