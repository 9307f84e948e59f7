"""The table of flying objects and the Moon: the format of objects.parquet in docs/dataset_format.md."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pyarrow as pa

from generator.frame.plan import FramePlan
from generator.frame.scene import ExpectedFrame
from generator.frame.star_truth import StarTruth
from generator.sky.moonlight import MOON_BV_MAG

MOON_OBJECT = -1

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
    """Return the truth of a frame's flying objects and of the Moon: those in the frame, occluded ones included.

    The Moon's row comes last, with the object number MOON_OBJECT and V above the atmosphere.
    """
    objects, moon = plan.objects, expected.moon
    number = np.concatenate([objects.number, np.full(len(moon.electrons), MOON_OBJECT)])
    kind = [*objects.kind, *["moon"] * len(moon.electrons)]
    v_mag = np.concatenate([objects.v_mag, np.full(len(moon.electrons), plan.sky.moon_v_mag)])
    bv_mag = np.concatenate([objects.bv_mag, np.full(len(moon.electrons), MOON_BV_MAG)])
    truth = StarTruth(
        *(
            np.concatenate([getattr(expected.objects, field.name), getattr(moon, field.name)])
            for field in fields(StarTruth)
        )
    )
    rows = np.flatnonzero((truth.fraction_in_frame > 0) | truth.occluded)
    centroid = np.where(np.isfinite(truth.centroid_px), truth.centroid_px, 0.5 * (truth.start_px + truth.end_px))
    columns = {
        "index": np.full(len(rows), plan.index),
        "frame_id": [plan.frame_id] * len(rows),
        "object": number[rows],
        "kind": [kind[row] for row in rows],
        "v_mag": v_mag[rows],
        "bv_mag": bv_mag[rows],
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
