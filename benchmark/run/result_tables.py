"""The tables of a result: one row per frame, one row per detection (docs/benchmark.md describes the columns)."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from benchmark.frames.conditions import FrameConditions
from benchmark.judge.outcome import SolverOutcome
from benchmark.stats.metrics import FrameScore

CONDITION_UNITS = {
    "limiting_magnitude": "mag",
    "moon_altitude_deg": "deg",
    "moon_illuminated": "1",
    "cloud_optical_depth": "1",
    "rate_deg_s": "deg s-1",
    "fov_deg": "deg",
    "azimuth_deg": "deg",
    "altitude_deg": "deg",
    "roll_deg": "deg",
}
"""Circumstances that have a column of their own name, with their units."""


def condition_values(conditions: FrameConditions) -> dict[str, float | int | None]:
    """The circumstances of a frame, by the names of their columns."""
    return {
        "zenith_mag_arcsec2": conditions.zenith_mag_arcsec2,
        "true_latitude_deg": conditions.latitude_deg,
        "true_longitude_deg": conditions.longitude_deg,
        "exposure_s": conditions.exposure_s,
        "n_in_field": conditions.n_in_field,
        **{name: finite(getattr(conditions, name)) for name in CONDITION_UNITS},
    }


def frame_table(outcomes: Sequence[SolverOutcome]) -> pa.Table:
    """One row per frame; every column's unit is in its field metadata."""
    scores = [outcome.score for outcome in outcomes]
    details = [outcome.details for outcome in outcomes]
    true = [condition_values(d.conditions) for d in details]
    columns: list[tuple[str, Any, str, list[Any]]] = [
        ("frame_id", pa.string(), "", [s.frame_id for s in scores]),
        ("index", pa.int32(), "", [s.index for s in scores]),
        ("bortle", pa.int32(), "", [s.bortle for s in scores]),
        ("width_px", pa.int32(), "px", [s.width_px for s in scores]),
        ("height_px", pa.int32(), "px", [s.height_px for s in scores]),
        ("zenith_mag_arcsec2", pa.float64(), "mag arcsec-2", [one["zenith_mag_arcsec2"] for one in true]),
        ("true_latitude_deg", pa.float64(), "deg", [one["true_latitude_deg"] for one in true]),
        ("true_longitude_deg", pa.float64(), "deg", [one["true_longitude_deg"] for one in true]),
        ("utc_mid", pa.string(), "", [d.utc for d in details]),
        ("exposure_s", pa.float64(), "s", [one["exposure_s"] for one in true]),
        ("n_in_field", pa.int32(), "", [one["n_in_field"] for one in true]),
        ("status", pa.string(), "", [s.status for s in scores]),
        ("reason", pa.string(), "", [s.reason for s in scores]),
        ("lat_deg", pa.float64(), "deg", [s.lat_deg for s in scores]),
        ("lon_deg", pa.float64(), "deg", [s.lon_deg for s in scores]),
        ("error_km", pa.float64(), "km", [finite(s.error_km) for s in scores]),
        ("cov_ee_km2", pa.float64(), "km2", [d.cov_km2[0] if d.cov_km2 else None for d in details]),
        ("cov_en_km2", pa.float64(), "km2", [d.cov_km2[1] if d.cov_km2 else None for d in details]),
        ("cov_nn_km2", pa.float64(), "km2", [d.cov_km2[2] if d.cov_km2 else None for d in details]),
        ("confidence", pa.float64(), "", [finite(d.confidence) for d in details]),
        ("n_detections", pa.int32(), "", [s.n_detections for s in scores]),
        ("n_detected_stars", pa.int32(), "", [s.n_detected_stars for s in scores]),
        ("n_matches", pa.int32(), "", [s.n_matches for s in scores]),
        ("n_correct", pa.int32(), "", [s.n_correct for s in scores]),
        ("time_ms", pa.float64(), "ms", [s.time_ms for s in scores]),
        ("detect_ms", pa.float64(), "ms", [d.detect_ms for d in details]),
        ("solve_ms", pa.float64(), "ms", [d.solve_ms for d in details]),
        ("condition", pa.float64(), "the task's", [finite(s.condition) for s in scores]),
        ("site", pa.string(), "", [d.site for d in details]),
        ("error_east_km", pa.float64(), "km", [finite(d.error_east_km) for d in details]),
        ("error_north_km", pa.float64(), "km", [finite(d.error_north_km) for d in details]),
        ("crlb_km", pa.float64(), "km", [finite(d.crlb_km) for d in details]),
        *((name, pa.float64(), unit, [one[name] for one in true]) for name, unit in CONDITION_UNITS.items()),
        ("peak_memory_mib", pa.float64(), "MiB", [finite(d.peak_memory_mib) for d in details]),
        ("image_sha256", pa.string(), "", [d.identity.image_sha256 for d in details]),
        ("truth_sha256", pa.string(), "", [d.identity.truth_sha256 for d in details]),
        ("stage_ms", pa.map_(pa.string(), pa.float64()), "ms", [list(d.stage_ms.items()) for d in details]),
    ]
    return _table(columns)


def match_table(outcomes: Sequence[SolverOutcome]) -> pa.Table:
    """One row per detection."""
    rows = [row for outcome in outcomes for row in outcome.detections]
    columns: list[tuple[str, Any, str, list[Any]]] = [
        ("frame_id", pa.string(), "", [r.frame_id for r in rows]),
        ("detection", pa.int32(), "", [r.detection for r in rows]),
        ("u_px", pa.float64(), "px", [r.u_px for r in rows]),
        ("v_px", pa.float64(), "px", [r.v_px for r in rows]),
        ("flux", pa.float64(), "detector's own", [r.flux for r in rows]),
        ("star_id", pa.int32(), "", [r.star_id for r in rows]),
        ("correct", pa.bool_(), "", [r.correct for r in rows]),
    ]
    return _table(columns)


def scores_of(frames: pa.Table) -> list[FrameScore]:
    """The scores in a table of frames, in its order."""
    names = [field.name for field in dataclasses.fields(FrameScore)]
    scores = []
    for row in frames.select(names).to_pylist():
        row["error_km"] = math.inf if row["error_km"] is None else row["error_km"]
        scores.append(FrameScore(**row))
    return scores


def in_order(table: pa.Table, frame_ids: Sequence[str]) -> pa.Table:
    """Select the rows of these frames, in this order; rows of the same frame keep their order."""
    place = pc.index_in(table["frame_id"], value_set=pa.array(frame_ids, pa.string()))
    known = pc.is_valid(place)
    numbered = pa.table({"place": place.filter(known), "row": pa.array(range(len(table)), pa.int64()).filter(known)})
    return table.take(numbered.sort_by([("place", "ascending"), ("row", "ascending")])["row"])


def _table(columns: Sequence[tuple[str, Any, str, list[Any]]]) -> pa.Table:
    schema = pa.schema([pa.field(name, kind, metadata={"unit": unit}) for name, kind, unit, _ in columns])
    return pa.Table.from_arrays([pa.array(values, type=kind) for _, kind, _, values in columns], schema=schema)


def finite(value: float | None) -> float | None:
    """The value, or None for infinity and NaN, which JSON and the tables write as null."""
    return None if value is None or not math.isfinite(value) else float(value)
