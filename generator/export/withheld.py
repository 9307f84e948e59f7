"""A dataset without its truth: images and the inputs of a solver, under names that reveal nothing."""

from __future__ import annotations

import hashlib
import hmac
import json
from pathlib import Path

from generator.dataset.reader import Dataset
from generator.export.form import ExportOptions, Progress
from generator.files import path_within, write_bytes
from generator.frame.render import png_bytes

PUBLIC_KEYS = ("format", "time", "camera", "attitude", "optics", "sensor")
"""Parts of the frame record that a solver may know."""
PUBLIC_TIME_KEYS = ("utc_start", "utc_mid", "exposure_s")
PUBLIC_AIR_KEYS = ("pressure_hpa", "temperature_c", "refraction")


def export_withheld(dataset: Dataset, out: Path, options: ExportOptions, progress: Progress) -> None:
    """Write images and the inputs of a solver under names that reveal nothing; truth and scenario are left out.

    Frames are named by a keyed hash of their index. The key is the hash of the scenario, which only its owner knows.
    Frames are listed in the order of these names.
    """
    del options
    entries = []
    for frame in dataset:
        record = frame.record
        name = withheld_name(dataset.manifest.scenario_sha256, frame.index)
        # If lens and mount drift, camera and attitude of the record are truth.
        public = {key: record[key] for key in PUBLIC_KEYS} | record.get("told", {}) | {"frame_id": name}
        public["time"] = {key: record["time"][key] for key in PUBLIC_TIME_KEYS}
        public["atmosphere"] = {key: record["atmosphere"][key] for key in PUBLIC_AIR_KEYS}
        # Encoded again, so that the file contains nothing else.
        image = png_bytes(frame.image)
        write_bytes(path_within(out, f"{name}.png"), image)
        write_bytes(path_within(out, f"{name}.json"), (json.dumps(public, indent=1) + "\n").encode())
        entries.append({"frame_id": name, "sha256": hashlib.sha256(image).hexdigest()})
        progress(frame.frame_id)
    listing = sorted(entries, key=lambda entry: entry["frame_id"])
    write_bytes(out / "frames.json", (json.dumps(listing, indent=1) + "\n").encode())


def withheld_name(scenario_sha256: str, index: int) -> str:
    """Name of frame `index` in a copy without truth (HMAC-SHA-256, RFC 2104)."""
    return "test-" + hmac.new(scenario_sha256.encode(), str(index).encode(), hashlib.sha256).hexdigest()[:16]
