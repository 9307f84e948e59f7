"""Satellites, aircraft and meteors: places, light and truth rows."""

import copy
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import skyfield_data
from skyfield.api import EarthSatellite, Loader, wgs84
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.render import render_dataset, render_frame

ISS = (
    "1 25544U 98067A   20015.53245370  .00001052  00000-0  26928-4 0  9996",
    "2 25544  51.6452  30.5112 0005169 131.6131 359.4453 15.49166270208211",
)
DARK = {"sky": None, "stars": {"limiting_magnitude": -2.0}}
TRAIL = {
    "kind": "satellite", "start": {"azimuth_deg": 100.0, "altitude_deg": 75.0},
    "end": {"azimuth_deg": 280.0, "altitude_deg": 80.0}, "v_mag": 2.0,
}  # fmt: skip


def rendered(*trails):
    plan = plan_frame(small_scenario(**DARK, foreground={"trails": [copy.deepcopy(trail) for trail in trails]}), 0)
    return plan, render_expected(plan)


def test_a_trail_runs_from_its_start_to_its_end() -> None:
    plan, frame = rendered(TRAIL)
    focal = plan.spec.camera.f_px
    for truth, azimuth, altitude in ((frame.objects.start_px, 100.0, 75.0), (frame.objects.end_px, 280.0, 80.0)):
        distance = focal / np.tan(np.radians(altitude))
        a = np.radians(azimuth)
        # Looking up, north is up in the image and east is on its left.
        assert truth[0] == pytest.approx([134.5 - distance * np.sin(a), 89.5 - distance * np.cos(a)], abs=1e-3)
    lit = np.argwhere(frame.electrons > 0.02 * frame.electrons.max())
    assert lit[:, 1].min() == pytest.approx(frame.objects.start_px[0, 0], abs=2)
    assert lit[:, 1].max() == pytest.approx(frame.objects.end_px[0, 0], abs=2)
    assert float(frame.electrons.astype(float).sum()) == pytest.approx(frame.objects.electrons[0], rel=2e-3)


@pytest.mark.parametrize(("change", "share"), [
    ({"start_s": 0.0, "end_s": 0.25}, 0.5), ({"start_s": -10.0, "end_s": -5.0}, 0.0),
    ({"kind": "aircraft", "strobe": {"period_s": 0.2, "flash_s": 0.02, "first_s": 0.01}}, 3 * 0.02 / 0.5),
    ({"kind": "meteor"}, 2 / 3), ({"kind": "meteor", "start_s": 0.1, "end_s": 0.3}, 2 / 3 * 0.2 / 0.5),
])  # fmt: skip
def test_light_is_on_for_its_time(change, share) -> None:
    """Electrons relative to a steady light at the same place: the part of the exposure, 2/3 under a parabola; 1 %."""
    place = {"start": {"azimuth_deg": 0.0, "altitude_deg": 89.99}, "end": {"azimuth_deg": 0.0, "altitude_deg": 89.98}}
    _, frame = rendered(TRAIL | place, TRAIL | place | change)
    steady, changed = frame.objects.electrons
    assert changed / steady == pytest.approx(share, rel=0.01, abs=1e-9)


def test_ends_are_where_the_light_is_seen() -> None:
    """A meteor that shines from a fifth to three fifths of the exposure, and two flashes."""
    whole = {"start": {"azimuth_deg": 90.0, "altitude_deg": 70.0}, "end": {"azimuth_deg": 270.0, "altitude_deg": 70.0}}
    meteor = {"kind": "meteor", "v_mag": -3.0, "start_s": 0.1, "end_s": 0.3} | whole
    plan, frame = rendered(meteor)
    distance = plan.spec.camera.f_px * np.tan(np.radians(20.0))
    assert frame.objects.start_px[0] == pytest.approx([134.5 - distance, 89.5], abs=1e-3)
    assert frame.objects.end_px[0] == pytest.approx([134.5 + distance, 89.5], abs=1e-3)
    plan, frame = rendered(TRAIL | {"kind": "aircraft", "strobe": {"period_s": 0.25, "flash_s": 0.01, "first_s": 0.12}})
    lit = np.argwhere(frame.electrons > 0.02 * frame.electrons.max())
    assert lit[:, 1].min() == pytest.approx(frame.objects.start_px[0, 0], abs=3)
    assert lit[:, 1].max() == pytest.approx(frame.objects.end_px[0, 0], abs=3)


@pytest.mark.parametrize("day", [(2020, 1, 15), (2016, 12, 31)])
def test_element_sets_against_skyfield(day) -> None:
    """Azimuth and altitude of a satellite within 0.01 deg of Skyfield's over a minute, on a day with a leap second too."""
    utc = "{:04}-{:02}-{:02}T18:00:00Z".format(*day)
    satellite = {"line1": ISS[0], "line2": ISS[1], "v_mag": -2.0}
    plan = plan_frame(
        small_scenario(
            **DARK, time={"utc_start": utc, "exposure_s": 60.0}, foreground={"satellites": [satellite]},
            atmosphere={"refraction": False},
        ), 0,
    )  # fmt: skip
    timescale = Loader(Path(skyfield_data.__file__).parent / "data", verbose=False).timescale(builtin=True)
    where = EarthSatellite(*ISS, ts=timescale) - wgs84.latlon(52.0, 4.36)
    for keyframe, second in ((0, 0.0), (32, 30.0), (64, 60.0)):
        altitude, azimuth, _ = where.at(timescale.utc(*day, 18, 0, second)).altaz()
        a, h = azimuth.radians, altitude.radians
        wanted = np.array([np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)])
        apart = np.degrees(np.arccos(np.clip(wanted @ plan.objects.directions[0, keyframe], -1, 1)))
        assert apart < 0.01


@pytest.mark.parametrize(
    ("lines", "fragment"),
    [
        ((ISS[0][:-1] + str((int(ISS[0][-1]) + 1) % 10), ISS[1]), "checksum"),
        ((ISS[1], ISS[0]), "lines 1 and 2"),
        ((ISS[0], "2 25544" + " " * 61 + "4"), "not a two-line element set"),
        ((ISS[0][:40], ISS[1]), "at least 69"),
    ],
)
def test_bad_element_sets_are_refused_when_the_scenario_is_read(lines, fragment) -> None:
    with pytest.raises(ScenarioError, match=fragment) as caught:
        small_scenario(foreground={"satellites": [{"line1": lines[0], "line2": lines[1], "v_mag": 1.0}]})
    assert "foreground.satellites.0" in str(caught.value)


def test_objects_have_rows_of_their_own(tmp_path) -> None:
    later = copy.deepcopy(TRAIL) | {"start_s": 5.0, "end_s": 6.0}
    scenario = small_scenario(**DARK, foreground={"trails": [TRAIL, later]})
    render_dataset(scenario, tmp_path / "frames")
    table = pq.read_table(tmp_path / "frames" / "objects.parquet").to_pandas()
    assert table["object"].tolist() == [0]
    assert table["kind"].tolist() == ["satellite"]
    assert not table["occluded"].any()
    assert table["electrons_e"][0] > 0
    render_dataset(small_scenario(**DARK), tmp_path / "frames", overwrite=True)
    assert not (tmp_path / "frames" / "objects.parquet").exists()


def test_a_frame_whose_only_object_is_below_the_horizon_is_rendered() -> None:
    satellite = {"line1": ISS[0], "line2": ISS[1], "v_mag": -2.0}
    late = {"utc_start": "2020-01-15T18:45:00Z", "exposure_s": 1.0}  # half an orbit later
    scenario = small_scenario(**(DARK | {"time": late}), foreground={"satellites": [satellite]})
    assert plan_frame(scenario, 0).objects.directions[0, :, 2].max() < -0.1
    assert render_frame(scenario, 0).objects.num_rows == 0
