"""The table of flying objects: what docs/dataset_format.md promises of objects.parquet."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from generator.frame_plan import FramePlan
from generator.scene import ExpectedFrame

OBJECT_COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("index", pa.int32(), ""),
    ("frame_id", pa.string(), ""),
    ("object", pa.int32(), ""),
    ("kind", pa.string(), ""),
    ("v_mag", pa.float32(), "mag"),
    ("bv_mag", pa.float32(), "mag"),
    ("centroid_u_px", pa.float64(), "px"),
    ("centroid_v_px", pa.float64(), "px"),
    ("start_u_px", pa.float64(), "px"),
    ("start_v_px", pa.float64(), "px"),
    ("end_u_px", pa.float64(), "px"),
    ("end_v_px", pa.float64(), "px"),
    ("electrons_e", pa.float32(), "e"),
    ("fraction_in_frame", pa.float32(), "1"),
    ("occluded", pa.bool_(), ""),
)
OBJECT_SCHEMA = pa.schema(
    [pa.field(name, kind, nullable=False, metadata={"unit": unit}) for name, kind, unit in OBJECT_COLUMNS],
    metadata={"format": "skybench-objects/1"},
)


def object_table(plan: FramePlan, expected: ExpectedFrame) -> pa.Table:
    """Return the truth of a frame's flying objects: those whose light reaches the frame, hidden ones included."""
    objects, truth = plan.objects, expected.objects
    rows = np.flatnonzero((truth.fraction_in_frame > 0) | truth.occluded)
    centroid = np.where(np.isfinite(truth.centroid_px), truth.centroid_px, 0.5 * (truth.start_px + truth.end_px))
    columns = {
        "index": np.full(len(rows), plan.index),
        "frame_id": [plan.frame_id] * len(rows),
        "object": objects.number[rows],
        "kind": [objects.kind[row] for row in rows],
        "v_mag": objects.v_mag[rows],
        "bv_mag": objects.bv_mag[rows],
        "centroid_u_px": centroid[rows, 0],
        "centroid_v_px": centroid[rows, 1],
        "start_u_px": truth.start_px[rows, 0],
        "start_v_px": truth.start_px[rows, 1],
        "end_u_px": truth.end_px[rows, 0],
        "end_v_px": truth.end_px[rows, 1],
        "electrons_e": truth.electrons[rows],
        "fraction_in_frame": truth.fraction_in_frame[rows],
        "occluded": truth.occluded[rows],
    }
    arrays = [pa.array(columns[field.name], type=field.type) for field in OBJECT_SCHEMA]
    return pa.Table.from_arrays(arrays, schema=OBJECT_SCHEMA)
