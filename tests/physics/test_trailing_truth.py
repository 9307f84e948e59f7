"""Truth of stars that trail: which are listed, which saturate, and how far their light reaches."""

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_scenes import small_scenario

from generator.export.annotations import annotate, outlines
from generator.frame.exposure.expected import render_expected
from generator.frame.object_table import object_table
from generator.frame.plan import FramePlan, plan_frame
from generator.frame.record import LEAST_LIGHT_E, frame_record, star_table
from generator.frame.scene import ExpectedFrame
from generator.sensor.detector import saturation_e

SCENE: dict[str, Any] = {"sky__bortle": None, "camera__width": 480, "camera__height": 360, "camera__hfov_deg": 60.0}
SWING: dict[str, Any] = {"time__exposure_s": 1.0, "motion": {"gimbal": {"sigma_deg": 0.5, "correlation_s": 0.2}}}


def rendered(**overrides: Any) -> tuple[FramePlan, ExpectedFrame, pa.Table]:
    plan = plan_frame(small_scenario(**(SCENE | overrides)), 0)
    expected = render_expected(plan, channels=False)
    return plan, expected, star_table(plan, expected)


@pytest.mark.parametrize(("overrides", "from_outside"), [
    ({}, 0),
    ({"motion": {"rate_deg_s": [0, 20, 0]}}, 20),
    ({"time__exposure_s": 3600.0, "camera__aperture_mm": 1.0}, 20),
])  # fmt: skip
def test_all_light_in_the_frame_is_of_listed_stars(overrides: dict[str, Any], from_outside: int) -> None:
    _, expected, table = rendered(**overrides, stars={"limiting_magnitude": 6.0})
    stars = table.to_pandas()
    inside = stars["u_px"].between(-10, 490) & stars["v_px"].between(-10, 370)
    assert (~inside).sum() >= from_outside
    light_e = float((stars["electrons_e"].astype(float) * stars["fraction_in_frame"]).sum())
    assert float(expected.electrons.sum(dtype=float)) == pytest.approx(light_e, rel=3e-4)
    arriving_e = (stars["electrons_e"] * stars["fraction_in_frame"])[~inside]
    assert (arriving_e >= LEAST_LIGHT_E * 0.999).all()


def test_a_star_saturates_wherever_its_trail_fills_a_pixel() -> None:
    swing: dict[str, Any] = {"time__exposure_s": 1.0, "motion": {"gimbal": {"sigma_deg": 0.3, "correlation_s": 0.2}}}
    plan, expected, table = rendered(**swing, sensor__full_well_e=1500.0, stars={"limiting_magnitude": 4.0})
    full = expected.electrons >= saturation_e(plan.spec.sensor, 1.0) - plan.spec.sensor.mean_dark_e_s
    stars = table.to_pandas().query("electrons_e > 500").reset_index()
    low = np.floor(stars[["low_u_px", "low_v_px"]].to_numpy()).astype(int) - 4
    high = np.ceil(stars[["high_u_px", "high_v_px"]].to_numpy()).astype(int) + 4
    flagged, away = 0, 0
    for row in range(len(stars)):
        apart = (low > high[row]).any(axis=1) | (high < low[row]).any(axis=1)
        if apart.sum() < len(stars) - 1 or (low[row] < 0).any() or (high[row] >= (480, 360)).any():
            continue
        fills = full[low[row, 1] : high[row, 1] + 1, low[row, 0] : high[row, 0] + 1].any()
        assert stars["saturated"][row] == fills
        u, v = round(stars["u_px"][row]), round(stars["v_px"][row])
        flagged += int(fills)
        away += int(fills and not full[v - 1 : v + 2, u - 1 : u + 2].any())
    assert flagged >= 3
    assert away >= 1


@pytest.mark.parametrize("motion", [
    {"rate_deg_s": [0, 5, 0]},
    {"polynomial_deg": [[5, -5], [3], [0]]},
    SWING["motion"],
])  # fmt: skip
def test_boxes_hold_the_light_of_a_camera_that_swings(motion: dict[str, Any]) -> None:
    plan, expected, table = rendered(time__exposure_s=1.0, motion=motion, stars={"limiting_magnitude": 3.0})
    record, image = frame_record(plan, expected, table), np.zeros(expected.electrons.shape, np.uint16)
    frame: Any = SimpleNamespace(record=record, image=image, stars=table, objects=object_table(plan, expected))
    found = annotate(frame, 0.0)
    covered = np.zeros(expected.electrons.shape, dtype=bool)
    for left, top, right, bottom in found.box:
        covered[int(top) : int(np.ceil(bottom)), int(left) : int(np.ceil(right))] = True
    assert expected.electrons[covered].sum(dtype=float) > 0.97 * expected.electrons.sum(dtype=float)
    assert len(outlines(found, 480, 360)) == len(found)


def test_corners_are_rounded_outwards_to_sixteenths_and_compress() -> None:
    """The range contains the star's ends and is at most a sixteenth wider; the columns take less room."""
    plan, expected, table = rendered(**SWING, stars={"limiting_magnitude": 6.0})
    for name in ("low_u_px", "low_v_px", "high_u_px", "high_v_px"):
        steps = table[name].to_numpy().astype(float) * 16
        np.testing.assert_array_equal(steps, np.rint(steps))
    row_of = {star: row for row, star in enumerate(plan.stars.star_id.tolist())}
    rows = [row_of[star] for star in table["star_id"].to_pylist()]
    for name, exact, outwards in (("low", expected.low_px[rows], -1), ("high", expected.high_px[rows], 1)):
        stated = np.stack([table[f"{name}_{axis}_px"].to_numpy() for axis in "uv"], axis=1)
        lit = np.isfinite(exact).all(axis=1)
        added = outwards * (stated - exact)[lit]
        assert added.min() >= 0
        assert added.max() < 1 / 16
    unrounded = pa.table({name: expected.low_px[rows, axis].astype(np.float32) for axis, name in enumerate("uv")})
    assert size(pa.table({name: table[f"low_{name}_px"] for name in "uv"})) < 0.85 * size(unrounded)


def size(table: pa.Table) -> int:
    """Bytes of a table's file."""
    file = io.BytesIO()
    pq.write_table(table, file, compression="zstd")
    return len(file.getvalue())
