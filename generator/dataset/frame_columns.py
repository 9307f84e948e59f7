"""The table of frames: one row per frame with the scalars of its record."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import pyarrow as pa

from generator.frame.record import pointing_object

_UNITS = {
    "_deg": "deg", "_m": "m", "_s": "s", "_arcsec": "arcsec", "_px": "px", "_mm": "mm", "_hpa": "hPa", "_c": "deg C",
    "_e": "e", "_dn": "DN", "_e_s": "e/s", "_e_per_dn": "e/DN", "_du": "DU", "_rad": "rad", "_mag": "mag",
    "_arcsec2": "mag/arcsec2",
}  # fmt: skip

# Column, place in the frame record, type.
_COLUMNS: tuple[tuple[str, str, pa.DataType], ...] = (
    ("index", "index", pa.int64()),
    ("frame_id", "frame_id", pa.string()),
    ("scenario", "scenario.name", pa.string()),
    ("scenario_sha256", "scenario.sha256", pa.string()),
    ("sequence", "sequence.index", pa.int32()),
    ("step", "sequence.step", pa.int32()),
    ("latitude_deg", "site.latitude_deg", pa.float64()),
    ("longitude_deg", "site.longitude_deg", pa.float64()),
    ("height_m", "site.height_m", pa.float64()),
    ("utc_start", "time.utc_start", pa.string()),
    ("utc_mid", "time.utc_mid", pa.string()),
    ("exposure_s", "time.exposure_s", pa.float64()),
    ("ut1_utc_s", "time.ut1_utc_s", pa.float64()),
    ("camera_model", "camera.model", pa.string()),
    ("width_px", "camera.width", pa.int32()),
    ("height_px", "camera.height", pa.int32()),
    ("f_px", "camera.f_px", pa.float64()),
    ("fy_px", "camera.fy_px", pa.float64()),
    ("cx_px", "camera.cx_px", pa.float64()),
    ("cy_px", "camera.cy_px", pa.float64()),
    ("k", "camera.k", pa.list_(pa.float64())),
    ("p", "camera.p", pa.list_(pa.float64())),
    ("s", "camera.s", pa.list_(pa.float64())),
    ("tilt_rad", "camera.tilt_rad", pa.list_(pa.float64())),
    ("azimuth_deg", "attitude.azimuth_deg", pa.float64()),
    ("altitude_deg", "attitude.altitude_deg", pa.float64()),
    ("roll_deg", "attitude.roll_deg", pa.float64()),
    ("R_cam", "attitude.R_cam", pa.list_(pa.float64(), 9)),
    ("pressure_hpa", "atmosphere.pressure_hpa", pa.float64()),
    ("temperature_c", "atmosphere.temperature_c", pa.float64()),
    ("aerosol_tau_550", "atmosphere.aerosol_tau_550", pa.float64()),
    ("bortle", "sky.bortle", pa.int32()),
    ("zenith_mag_arcsec2", "sky.zenith_mag_arcsec2", pa.float64()),
    ("sun_altitude_deg", "sky.sun_altitude_deg", pa.float64()),
    ("moon_altitude_deg", "sky.moon_altitude_deg", pa.float64()),
    ("moon_phase_angle_deg", "sky.moon_phase_angle_deg", pa.float64()),
    ("limiting_magnitude", "stars.limiting_magnitude", pa.float64()),
    ("n_in_field", "stars.n_in_field", pa.int32()),
    ("n_visible", "stars.n_visible", pa.int32()),
)
_LATER = {"n_visible", "azimuth_deg", "altitude_deg", "roll_deg"}
"""Columns that frame records of early development versions lack; pointing then follows from the matrix."""
_OPTIONAL = _LATER | {"sequence", "step", "s", "tilt_rad"}
"""Columns that are empty if the frame record lacks the value: independent frames have no sequence, and most lenses neither
thin prism nor tilt."""


def unit_of(column: str) -> str:
    """Return the unit in a column's name, or an empty string."""
    suffixes = [suffix for suffix in _UNITS if column.endswith(suffix)]
    return _UNITS[max(suffixes, key=len)] if suffixes else ""


FRAME_SCHEMA = pa.schema(
    [
        *(pa.field(name, kind, metadata={"unit": unit_of(name)}) for name, _, kind in _COLUMNS),
        pa.field("split", pa.string(), metadata={"unit": ""}),
        pa.field("shard", pa.string(), metadata={"unit": ""}),
        pa.field("image", pa.string(), metadata={"unit": ""}),
        pa.field("image_sha256", pa.string(), metadata={"unit": ""}),
    ],
    metadata={"format": "skybench-frames/1"},
)


def frame_row(record: dict[str, Any], split: str, shard: str, image: str, image_bytes: bytes) -> dict[str, Any]:
    """Row of the table of frames (schema: FRAME_SCHEMA) for a frame record and its encoded image."""
    row: dict[str, Any] = {}
    attitude = record["attitude"]
    record = record | {"attitude": pointing_object(np.asarray(attitude["R_cam"])) | attitude}
    for column, place, _ in _COLUMNS:
        value: Any = record
        for key in place.split("."):
            value = value.get(key, {} if key == "sequence" else None) if column in _OPTIONAL else value[key]
        row[column] = [number for line in value for number in line] if column == "R_cam" else value
    digest = hashlib.sha256(image_bytes).hexdigest()
    return row | {"split": split, "shard": shard, "image": image, "image_sha256": digest}
