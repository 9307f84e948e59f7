"""Pointing in the frame record and in the table of frames."""

from typing import Any

import pytest
from small_scenes import small_scenario

from generator.dataset.frame_columns import _COLUMNS, frame_row
from generator.frame.record import attitude_object
from generator.optics.motion import plan_motion

TURNED = {"azimuth_deg": 300.25, "altitude_deg": -3.5, "roll_deg": -120.0}


@pytest.fixture(scope="module")
def attitude() -> dict[str, Any]:
    return attitude_object(plan_motion(small_scenario(attitude=TURNED).frame(0), 0, 0))


def record_with(attitude: dict[str, Any]) -> dict[str, Any]:
    """A record with nothing but nulls besides its attitude."""
    record: dict[str, Any] = {}
    for _, place, _ in _COLUMNS:
        *sections, name = place.split(".")
        inner = record
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[name] = None
    return record | {"attitude": attitude}


def test_the_record_states_the_pointing_of_the_scenario(attitude) -> None:
    assert {name: attitude[name] for name in TURNED} == TURNED


def test_the_table_has_it_for_records_that_lack_it_too(attitude) -> None:
    for written in (attitude, {"R_cam": attitude["R_cam"]}):
        row = frame_row(record_with(written), "train", "shard-000000", "frame-00000.png", b"")
        assert {name: row[name] for name in TURNED} == TURNED
        assert row["R_cam"] == [number for line in attitude["R_cam"] for number in line]


def test_the_table_counts_sequences_and_frames_by_themselves_have_none(attitude) -> None:
    record = record_with(attitude)
    row = frame_row(record | {"sequence": {"index": 2, "step": 5}}, "train", "shard-000000", "frame-00000.png", b"")
    assert (row["sequence"], row["step"]) == (2, 5)
    del record["sequence"]
    row = frame_row(record, "train", "shard-000000", "frame-00000.png", b"")
    assert (row["sequence"], row["step"]) == (None, None)
