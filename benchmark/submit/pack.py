"""Packing frames without their truth for solvers that run elsewhere, and the truth against which they are scored."""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
import io
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import celnav
from benchmark.errors import DatasetError, ResultsError
from benchmark.frames.dataset import Frame, load_image
from benchmark.frames.record_values import FRAME_FORMAT
from benchmark.stats.metrics import REFUSED
from benchmark.submit.csv_cells import csv_lines
from benchmark.submit.submission import FRAME_COLUMNS
from generator.errors import GeneratorError
from generator.files import read_at_most, write_bytes
from generator.reading.json_text import strict_json

LISTING = "frames.json"
TEMPLATE = "answers.csv"
LARGEST_LISTING_BYTES = 64 * 2**20
DATE_UNIX_S = 946_684_800
"""Date of every file of a set, 2000-01-01, so that file dates reveal nothing."""


def withheld_names(frames: Sequence[Frame]) -> dict[str, str]:
    """Name of each frame in a set without truth, by frame id.

    It is a keyed hash of the id (HMAC-SHA-256, RFC 2104) whose key is a hash of the truth. Names therefore reveal nothing
    without the truth, and require nothing else with it.
    """
    digest = hashlib.sha256()
    for frame in sorted(frames, key=lambda frame: frame.frame_id):
        place = (frame.conditions.latitude_deg, frame.conditions.longitude_deg)
        digest.update(f"{frame.frame_id}:{place!r}:".encode())
        digest.update(np.ascontiguousarray(frame.truth.star_id).tobytes())
        digest.update(np.ascontiguousarray(frame.truth.uv).tobytes())
    key = digest.digest()
    return {
        frame.frame_id: "test-" + hmac.new(key, frame.frame_id.encode(), hashlib.sha256).hexdigest()[:16]
        for frame in frames
    }


def pack(
    frames: Sequence[Frame],
    out: Path,
    progress: Callable[[str], None] = lambda name: None,
    names: Mapping[str, str] | None = None,
) -> None:
    """Write images with the records that solvers receive, without the truth.

    Files are written in the order of their names, and all have the same date.

    Parameters
    ----------
    frames : sequence of Frame
        Frames of a dataset or of a task.
    out : Path
        An empty or new folder. It gets NAME.png and NAME.json for each frame, then a form for the answers, then the list.
    progress : callable
        Called with the name of each frame written.
    names : mapping of str to str, optional
        Name of each frame by its id; by default `withheld_names`.

    Raises
    ------
    DatasetError
        An image is missing or damaged.
    ResultsError
        `out` cannot be used.
    """
    names = withheld_names(frames) if names is None else names
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise ResultsError(f"{out}: is not empty; choose another folder")
        listing = []
        # In the order of the names, so that not even the files' times reveal the order of the frames.
        for frame in sorted(frames, key=lambda frame: names[frame.frame_id]):
            name = names[frame.frame_id]
            image = _png(load_image(frame))
            _write(out / f"{name}.png", image)
            _write(out / f"{name}.json", (json.dumps(public_record(name, frame), indent=1) + "\n").encode())
            listing.append({"frame_id": name, "sha256": hashlib.sha256(image).hexdigest()})
            progress(name)
        rows = [(entry["frame_id"], REFUSED, *[""] * (len(FRAME_COLUMNS) - 2)) for entry in listing]
        _write(out / TEMPLATE, csv_lines([FRAME_COLUMNS, *rows]).encode())
        _write(out / LISTING, (json.dumps(listing, indent=1) + "\n").encode())
    except OSError as error:
        raise ResultsError(f"{error.filename or out}: {error.strerror}; choose another folder") from error


def _write(path: Path, content: bytes) -> None:
    write_bytes(path, content)
    os.utime(path, (DATE_UNIX_S, DATE_UNIX_S))


def public_record(name: str, frame: Frame) -> dict[str, Any]:
    """Record of a frame that solvers receive, with the keys of the frame record; a null sigma means an unknown heading."""
    seen = frame.observation
    heading = seen.heading_sigma_deg
    return {
        "format": FRAME_FORMAT,
        "frame_id": name,
        "time": {"utc_mid": seen.utc, "utc_sigma_s": seen.utc_sigma_s},
        "camera": seen.camera.as_given(),
        "camera_sigma": {
            "focal_sigma": seen.focal_sigma,
            "principal_point_sigma_px": seen.principal_point_sigma_px,
            "distortion_sigma": seen.distortion_sigma,
        },
        "attitude": {
            "R_cam": np.asarray(seen.R_cam).tolist(),
            **dataclasses.asdict(celnav.Pointing.of(seen.R_cam)),
            "tilt_sigma_deg": seen.tilt_sigma_deg,
            "heading_sigma_deg": heading if math.isfinite(heading) else None,
        },
        "atmosphere": {
            "pressure_hpa": seen.pressure_hpa,
            "temperature_c": seen.temperature_c,
            "pressure_sigma_hpa": seen.pressure_sigma_hpa,
            "temperature_sigma_c": seen.temperature_sigma_c,
        },
        **({} if seen.sequence is None else {"sequence": seen.sequence.as_given()}),
    }


def listed_names(folder: Path) -> frozenset[str]:
    """Names of the frames of a packed set.

    Raises
    ------
    DatasetError
        The folder has no list of frames.
    """
    path = folder / LISTING
    try:
        listing = strict_json(read_at_most(path, LARGEST_LISTING_BYTES), LISTING, LARGEST_LISTING_BYTES)
        return frozenset(str(entry["frame_id"]) for entry in listing)
    except (OSError, GeneratorError, KeyError, TypeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise DatasetError(
            f"{path}: no list of frames ({reason}); make the set with `skybench bench pack-test`"
        ) from error


def _png(image: NDArray[np.uint16]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()
