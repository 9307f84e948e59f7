"""Sequences: which frames they hold, what is drawn once, how a path carries the camera, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from scipy.spatial.transform import Rotation
from small_scenes import BASE, small_scenario

from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.dataset.reader import Dataset
from generator.dataset.verify import problems
from generator.errors import ScenarioError
from generator.frame.folder import IMU_FILE
from generator.frame.plan import plan_frame
from generator.frame.record import frame_record, record_bytes
from generator.frame.render import png_bytes, render_dataset, render_frame
from generator.imu.table import IMU_SCHEMA, imu_table
from generator.scenario.file import Scenario, load_scenario
from generator.scenario.model import pointing_matrix

TIME = {"utc_start": "2020-01-15T20:00:00Z", "exposure_s": 0.5, "every_s": 2.5, "count": 4}
KEYS = ("t_s", "latitude_deg", "longitude_deg", "height_m", "azimuth_deg", "altitude_deg", "roll_deg")
WAYPOINTS = [
    dict(zip(KEYS, values, strict=True))
    for values in (
        (0, 52.0, 4.36, 300, 0, 80, 0),
        (4, 52.001, 4.36, 310, 20, 75, 5),
        (9, 52.002, 4.362, 310, 60, 75, 5),
    )
]
TINY = {
    "camera": {"width": 64, "height": 48, "hfov_deg": 60, "aperture_mm": 4},
    "sky": {},
    "stars": {"limiting_magnitude": 5.0},
}


def moving(**overrides) -> Scenario:
    """A tiny camera on a turning vehicle."""
    return small_scenario(**({"time": TIME, "site": None, "path": {"waypoints": WAYPOINTS}} | TINY | overrides))


def test_frames_follow_each_other_at_equal_intervals() -> None:
    scenario = small_scenario(
        time=TIME | {"utc_start": "2016-12-31T23:59:58Z"}, frames=2, sky__bortle={"sweep": [2, 5]}
    )
    assert (scenario.frame_count, scenario.sequence_count, scenario.frames_per_combination) == (16, 4, 8)
    frames = [scenario.frame(index) for index in range(16)]
    # Across a leap second.
    assert [frame.time.utc_start[17:25] for frame in frames[:4]] == ["58.00000", "60.50000", "02.00000", "04.50000"]
    assert [frame.time.utc_start for frame in frames[4:8]] == [frame.time.utc_start for frame in frames[:4]]
    assert [frame.sky.bortle for frame in frames] == [2] * 8 + [5] * 8


def test_weather_is_drawn_once_for_a_sequence() -> None:
    scenario = small_scenario(time=TIME, frames=3, atmosphere={"aerosol_tau_550": {"uniform": [0.1, 0.5]}})
    depth = [scenario.frame(index).atmosphere.aerosol_tau_550 for index in range(12)]
    assert len(set(depth)) == 3
    assert depth == [value for value in depth[::4] for _ in range(4)]


def test_a_sequence_of_one_draws_as_frames_by_themselves_do() -> None:
    air = {"aerosol_tau_550": {"uniform": [0.1, 0.5]}}
    alone = small_scenario(frames=3, atmosphere=air)
    one_each = small_scenario(time=TIME | {"count": 1}, frames=3, atmosphere=air)
    for index in range(3):
        assert one_each.frame(index).atmosphere == alone.frame(index).atmosphere
        assert one_each.frame(index).time == alone.frame(index).time.model_copy(
            update={"utc_start": "2020-01-15T20:00:00.000000Z"}
        )


def test_a_time_of_night_is_drawn_for_where_the_path_begins() -> None:
    nights = {"utc": ["2020-06-21T00:00:00Z", "2020-06-22T00:00:00Z"], "sun_below_deg": -10}
    scenario = moving(time=TIME | {"utc_start": nights}, frames=5)
    starts = {scenario.sequence(number).time.utc_start for number in range(5)}
    assert len(starts) == 5
    assert all(start[11:13] in ("22", "23", "00", "01", "02") for start in starts)


def test_frames_on_a_path_stand_at_their_mid_exposure() -> None:
    scenario = moving()
    passage = scenario.passage(2)
    assert passage.start_s == 5.0
    assert passage.middle_s == 5.25
    latitude_deg, longitude_deg, height_m = (value[0] for value in passage.trajectory.position(np.array([5.25])))
    frame = scenario.frame(2)
    assert (frame.site.latitude_deg, frame.site.longitude_deg, frame.site.height_m) == (
        latitude_deg,
        longitude_deg,
        height_m,
    )
    plan = plan_frame(scenario, 2)
    assert plan.motion.R_mid == pytest.approx(frame.R_cam, abs=1e-12)
    assert len(plan.motion.R_cam) == 32
    # Blur of the exposure: the path's own turn.
    turned = Rotation.from_matrix(plan.motion.R_cam[-1]) * Rotation.from_matrix(plan.motion.R_cam[0]).inv()
    rate = passage.trajectory.rate_rad_s(np.array([5.25]))[0]
    assert -turned.as_rotvec() / 0.5 == pytest.approx(rate, abs=2e-4)  # the Earth's rotation is 0.7e-4


def test_path_goes_through_its_waypoints() -> None:
    trajectory = moving().passage(0).trajectory
    for waypoint in WAYPOINTS:
        attitude = trajectory.R_cam(np.array([float(waypoint["t_s"])])).as_matrix()[0]
        pointing = {key: float(waypoint[key]) for key in ("azimuth_deg", "altitude_deg", "roll_deg")}
        assert attitude == pytest.approx(
            pointing_matrix(small_scenario(attitude=pointing).frame(0).attitude), abs=1e-12
        )


def test_clouds_stay_over_the_ground_and_the_wind_blows_on_over_midnight() -> None:
    clouds = {"clouds": {"altitude_km": 2.0, "wind_m_s": 10.0, "wind_azimuth_deg": 90.0}}
    time = TIME | {"utc_start": "2020-01-15T23:59:55Z"}
    still = small_scenario(**(TINY | {"time": time, "sky": clouds}))
    carried = [plan_frame(still, index).sky.clouds.east_km for index in range(4)]
    assert np.diff(carried) == pytest.approx(2.5 * 10.0 / 1000)
    assert carried[0] == pytest.approx((86395 + 0.25) * 10.0 / 1000)
    flying = moving(sky=clouds | {"clouds": clouds["clouds"] | {"wind_m_s": 0.0}})
    field = plan_frame(flying, 3).sky.clouds
    passage = flying.passage(3)
    path = passage.trajectory.velocity_enu_m_s(np.linspace(0, passage.middle_s, 2001)).mean(axis=0) * passage.middle_s
    assert (field.east_km, field.north_km) == pytest.approx(tuple(-path[:2] / 1000), abs=1e-5)


@pytest.mark.parametrize("quaternions", [False, True])
def test_path_from_a_file_is_that_of_the_same_waypoints(tmp_path, quaternions) -> None:
    names = list(WAYPOINTS[0])
    rows = [[float(waypoint[name]) for name in names] for waypoint in WAYPOINTS]
    if quaternions:
        names = [*names[:4], "qx", "qy", "qz", "qw"]
        knots = moving().passage(0).trajectory.R_cam(np.array([row[0] for row in rows])).as_quat()
        rows = [[*row[:4], *quaternion] for row, quaternion in zip(rows, knots, strict=True)]
    lines = [",".join(names), *(",".join(repr(float(value)) for value in row) for row in rows)]
    (tmp_path / "flight.csv").write_text("\n".join(lines))
    tree = {key: value for key, value in BASE.items() if key != "site"} | TINY
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(tree | {"time": TIME, "path": {"file": "flight.csv"}}))
    scenario = load_scenario(tmp_path / "s.yaml")
    assert [file.path for file in scenario.files] == ["flight.csv"]
    for index in range(4):
        expected, found = moving().frame(index), scenario.frame(index)
        assert found.site == expected.site
        assert found.R_cam == pytest.approx(expected.R_cam, abs=1e-12)
    (tmp_path / "flight.csv").write_text("\n".join([*lines, ",".join(["12", *lines[-1].split(",")[1:]])]))
    with pytest.raises(ScenarioError, match="changed since"):
        scenario.frame(0)


def test_path_by_utc_is_that_by_seconds_after_the_start(tmp_path) -> None:
    tree = {key: value for key, value in BASE.items() if key != "site"} | TINY
    start = "2016-12-31T23:59:58Z"
    tree |= {"time": TIME | {"utc_start": start}, "path": {"file": "flight.csv"}}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(tree))
    times = ("23:59:57.250Z", "00:00:01Z", "00:00:06.500Z")  # with a leap second between: -0.75, 4, 9.5 s
    dates = ("2016-12-31T", "2017-01-01T", "2017-01-01T")
    frames = []
    for name, stamps in (
        ("utc", [date + time for date, time in zip(dates, times, strict=True)]),
        ("t_s", [-0.75, 4, 9.5]),
    ):
        rows = [[stamp, *list(waypoint.values())[1:]] for stamp, waypoint in zip(stamps, WAYPOINTS, strict=True)]
        lines = [",".join([name, *KEYS[1:]]), *(",".join(str(value) for value in row) for row in rows)]
        (tmp_path / "flight.csv").write_text("\n".join(lines))
        scenario = load_scenario(tmp_path / "s.yaml")
        frames.append([scenario.frame(index) for index in range(4)])
    for by_utc, by_seconds in zip(*frames, strict=True):
        assert by_utc.site.latitude_deg == pytest.approx(by_seconds.site.latitude_deg, abs=1e-12)
        assert by_utc.R_cam == pytest.approx(by_seconds.R_cam, abs=1e-9)


def test_hash_knows_the_sequence_and_leaves_others_alone() -> None:
    assert small_scenario(time=TIME).sha256 != small_scenario(time=TIME | {"every_s": 3.0}).sha256
    assert moving().sha256 != moving(imu={"rate_hz": 100.0}).sha256
    assert "path" not in small_scenario().frame(0).model_dump()


def short(place: int, **changes) -> list[dict]:
    """The waypoints with one of them changed; None removes a key."""
    changed = {key: value for key, value in (WAYPOINTS[place] | changes).items() if value is not None}
    return [changed if number == place else waypoint for number, waypoint in enumerate(WAYPOINTS)]


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"time": TIME | {"count": None}}, "time.count: found nothing, expected the number of frames"),
        ({"time": TIME | {"count": {"sweep": [2, 3]}}}, "time.count: found dict"),
        ({"time": TIME | {"count": 0}}, "time.count: found int 0"),
        ({"time": {key: value for key, value in TIME.items() if key != "every_s"}}, "time.every_s: missing"),
        ({"time": TIME | {"every_s": 0.2}}, "shorter than the exposure"),
        ({"time": TIME | {"count": 400}}, "path: covers t_s 0 to 9, but the sequence lasts from 0 to 998"),
        ({"path": {"waypoints": short(0, t_s=1)}}, "path: covers t_s 1 to 9"),
        ({"path": {"waypoints": short(1, t_s=9)}}, "t_s must increase"),
        ({"path": {"waypoints": short(1, t_s=1e-300)}}, "t_s must increase, by at least 1e-06 s"),
        ({"path": {"waypoints": short(1, roll_deg=None)}}, "waypoints.1.roll_deg: missing"),
        ({"path": {"waypoints": short(1, latitude_deg=91)}}, "path.waypoints.1.latitude_deg: found int 91"),
        ({"path": {"waypoints": [{"t_s": 0}, {"t_s": 9}]}}, "give latitude_deg"),
        ({"path": {}}, "give either file or waypoints"),
        ({"path": {"waypoints": short(1, height_m=19990)}}, "path: reaches heights"),
        ({"site": BASE["site"]}, "give positions either by site or by path"),
        ({"path": None}, "site: missing"),
        ({"attitude": "zenith-north-up"}, "give the attitude either by attitude or by path"),
        ({"motion": {"rate_deg_s": [0, 0, 1]}}, "motion.rate_deg_s: turns the camera in each frame"),
        ({"motion": {"imu": {}}}, "motion.imu"),
        ({"imu": {"rate_hz": 1e5}}, "imu.rate_hz: found float 100000.0"),
        ({"imu": {"gyro": {"bias_instability_deg_h": "3 deg/h"}}}, "in deg_h, without a unit of its own"),
        ({"paths": {}}, "did you mean 'path'"),
    ],
)
def test_refusals_name_the_key(overrides, message) -> None:
    with pytest.raises(ScenarioError, match=message.replace("[", r"\[")):
        moving(**overrides)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t_s,latitude_deg\n0,1\n9,1\n", "found the columns t_s, latitude_deg"),
        (
            "utc,qx,qy,qz,qw\n2020-01-15T20:00:00Z,0,0,0,1\n2020-01-15T20:00,0,0,0,1\n",
            "line 3, column utc: '2020-01-15T20:00'",
        ),
        (
            "utc,qx,qy,qz,qw\n2020-01-15T20:00:00Z,0,0,0,1\n2020-01-15T20:01:00Z,0,0,0,y\n",
            "line 3, column qw: found 'y'",
        ),
        ("t_s,qx,qy,qz,qw\n0,0,0,0,1\nnan,0,0,0,1\n", "line 3, column t_s: found 'nan'"),
        ("t_s,qx,qy,qz,qw\n0,0,0,0,1\n9,0,0,0,2\n", "found a length of 2 at t_s 9"),
        ("t_s,latitude_deg,longitude_deg,height_m\n0,52,4,0\n9,95,4,0\n", "column latitude_deg: found 95 at t_s 9"),
        ("t_s,latitude_deg,longitude_deg,height_m\n-1e300,52,4,0\n1e300,53,4,0\n", "column t_s: found -1e.300 at t_s"),
        (
            "t_s,qx,qy,qz,qw\n0,0,0,0,1\n1e-300,0,0,1,0\n100,0,1,0,0\n",
            "column t_s: found 1e-300 s between rows 1 and 2",
        ),
        (
            "utc,qx,qy,qz,qw\n2020-01-15T20:00:00Z,0,0,0,1\n2020-01-15T20:00:00.0000001Z,0,0,1,0\n",
            "column utc: found .* s between rows 1 and 2, expected at least 1e-06 s; leave one",
        ),
        ("t_s,latitude_deg,longitude_deg,height_m\n9,52,4,0\n0,52,4,0\n", "expected values that increase"),
        ("t_s,latitude_deg,longitude_deg,height_m\n0,52,4,x\n9,52,4,0\n", "expected a finite number"),
    ],
)
def test_bad_files_are_refused_with_their_fault(tmp_path, text, message) -> None:
    (tmp_path / "flight.csv").write_text(text)
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(BASE | TINY | {"time": TIME, "path": {"file": "flight.csv"}}))
    with pytest.raises(ScenarioError, match=message) as refusal:
        load_scenario(tmp_path / "s.yaml")
    assert "path.file: 'flight.csv'" in str(refusal.value)


def test_readings_are_the_scenarios_and_their_errors_have_streams_of_their_own() -> None:
    gyro = {"angle_random_walk_deg_sqrt_h": 0.3, "bias_instability_deg_h": 5.0, "bias_deg_h": [100, 0, 0]}
    scenario = moving(imu={"rate_hz": 50, "gyro": gyro}, frames=2)
    table = imu_table(scenario, 1)
    assert table.schema == IMU_SCHEMA
    assert table.num_rows == 400  # 8 s, to the end of the last exposure
    assert table == imu_table(scenario, 1)
    readings = table.to_pandas()
    assert readings["utc"].iloc[0] == "2020-01-15T20:00:00.020000Z"
    assert readings["gyro_bias_x_rad_s"].mean() == pytest.approx(np.radians(100 / 3600), rel=0.2)
    assert (readings["accelerometer_x_m_s2"] == readings["accelerometer_true_x_m_s2"]).all()
    other = imu_table(scenario, 0).to_pandas()
    assert (other["gyro_true_x_rad_s"] == readings["gyro_true_x_rad_s"]).all()
    assert (other["gyro_x_rad_s"] != readings["gyro_x_rad_s"]).all()
    shaken = moving(imu={"rate_hz": 50, "gyro": gyro, "accelerometer": {"bias_instability_ug": 40.0}}, frames=2)
    same = imu_table(shaken, 1).to_pandas()
    assert (same["gyro_x_rad_s"] == readings["gyro_x_rad_s"]).all()


def test_frames_have_the_same_bytes_alone_and_their_records_say_where_they_stand(tmp_path) -> None:
    scenario = moving(imu={"rate_hz": 20})
    render_dataset(scenario, tmp_path / "all", exr=False)
    alone = render_frame(moving(imu={"rate_hz": 20}), 2)
    assert (tmp_path / "all/frame-00002.png").read_bytes() == png_bytes(alone.dn)
    record = record_bytes(frame_record(alone.plan, alone.expected, alone.stars))
    assert (tmp_path / "all/frame-00002.json").read_bytes() == record
    sequence = json.loads(record)["sequence"]
    assert set(sequence) == {"index", "step", "start_s", "velocity_enu_m_s"}
    assert (sequence["index"], sequence["step"], sequence["start_s"]) == (0, 2, 5.0)
    assert np.linalg.norm(sequence["velocity_enu_m_s"]) == pytest.approx(35, rel=0.3)
    assert pq.read_table(tmp_path / "all" / IMU_FILE).num_rows == 160
    # A folder that lost its readings gets the same ones again.
    before = (tmp_path / "all" / IMU_FILE).read_bytes()
    (tmp_path / "all" / IMU_FILE).unlink()
    render_dataset(scenario, tmp_path / "all", exr=False)
    assert (tmp_path / "all" / IMU_FILE).read_bytes() == before


def test_datasets_hold_a_table_of_readings_for_each_sequence(tmp_path) -> None:
    tree = {key: value for key, value in BASE.items() if key != "site"} | TINY
    tree |= {"time": TIME | {"count": 2}, "path": {"waypoints": WAYPOINTS}, "imu": {"rate_hz": 20}, "frames": 3}
    text = yaml.safe_dump(tree)
    (tmp_path / "s.yaml").write_text(text)
    scenario = load_scenario(tmp_path / "s.yaml")
    generate(scenario, text, tmp_path / "set", DatasetSpec(shard_size=4), frames=(2, 5))
    assert problems(tmp_path / "set") == []
    dataset = Dataset.open(tmp_path / "set")
    assert [path.name for path in dataset.paths("imu")] == ["sequence-000001.parquet", "sequence-000002.parquet"]
    assert set(dataset.imu()["sequence"].to_pylist()) == {1, 2}
    description = json.loads((tmp_path / "set/croissant.json").read_text())
    assert "imu" in [records["name"] for records in description["recordSet"]]
    assert "imu/train/*.parquet" in (tmp_path / "set/README.md").read_text()
    dataset.paths("imu")[0].unlink()
    assert problems(tmp_path / "set") == ["imu/train/sequence-000001.parquet: missing"]
