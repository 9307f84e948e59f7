"""Pointing: hand-made cases, an independent formula, and the way back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from celnav import Attitude, Pointing
from celnav.command.attitude_option import read_attitude
from celnav.command.checks.remedies import ATTITUDE_KEYS, ATTITUDE_NAMES, naming_attitudes
from celnav.errors import AttitudeError

EAST, NORTH, UP = np.eye(3)


@pytest.mark.parametrize(
    ("pointing", "right", "down", "boresight"),
    [
        (Pointing(0, 0), EAST, -UP, NORTH),
        (Pointing(90, 0), -NORTH, -UP, EAST),
        (Pointing(0, 0, 90), -UP, -EAST, NORTH),  # turned clockwise: the right edge is below
        (Pointing(0, 0, 180), -EAST, UP, NORTH),
        (Pointing(180, 90), -EAST, -NORTH, UP),
        (Pointing(0, -90), EAST, -NORTH, -UP),
        (Pointing(0, 45), EAST, (NORTH - UP) / np.sqrt(2), (NORTH + UP) / np.sqrt(2)),
    ],
)
def test_cases_by_hand(pointing, right, down, boresight) -> None:
    np.testing.assert_allclose(pointing.R_cam, [right, down, boresight], atol=1e-15)


def test_zenith_with_north_up_has_the_azimuth_180() -> None:
    found = Pointing.of(Attitude.zenith_north_up().R_cam)
    assert (found.azimuth_deg, found.altitude_deg, found.roll_deg) == (180.0, 90.0, 0.0)


angles = st.tuples(st.floats(0, 359.999), st.floats(-89.99, 89.99), st.floats(-179.999, 180))


@given(angles)
def test_agrees_with_euler_angles_and_finds_the_way_back(angle) -> None:
    azimuth, altitude, roll = angle
    pointing = Pointing(azimuth, altitude, roll)
    # A camera that looks north with its top up, turned about its own axes: azimuth about up, altitude about right, roll.
    level = np.array([EAST, -UP, NORTH])
    turned = Rotation.from_euler("ZXY", [-azimuth, altitude, roll], degrees=True).as_matrix()
    np.testing.assert_allclose(pointing.R_cam, level @ turned.T, atol=1e-13)
    back = Pointing.of(pointing.R_cam)
    apart = Rotation.from_matrix(back.R_cam @ pointing.R_cam.T).magnitude()
    assert apart < 1e-12
    difference = np.array([back.azimuth_deg - azimuth, back.altitude_deg - altitude, back.roll_deg - roll])
    np.testing.assert_allclose((difference + 180) % 360 - 180, 0, atol=1e-8)


@pytest.mark.parametrize("altitude", [90.0, -90.0])
@pytest.mark.parametrize("azimuth", [0.0, 33.0, 301.0])
def test_at_the_poles_the_azimuth_is_180(altitude, azimuth) -> None:
    turned = Pointing(azimuth, altitude, 40.0)
    back = Pointing.of(turned.R_cam)
    assert back.azimuth_deg == 180.0
    np.testing.assert_allclose(back.R_cam, turned.R_cam, atol=1e-12)


@pytest.mark.parametrize("bad", [(0, 91, 0), (float("nan"), 0, 0), (0, 0, float("inf"))])
def test_impossible_angles_are_refused(bad) -> None:
    with pytest.raises(AttitudeError):
        Pointing(*bad)


def test_the_option_reads_angles() -> None:
    np.testing.assert_array_equal(read_attitude("azimuth=120, altitude=45,roll=-3").R_cam, Pointing(120, 45, -3).R_cam)
    uncertain = read_attitude("azimuth=120,altitude=45,tilt_sigma=0.5,heading_sigma=4")
    assert (uncertain.tilt_deg, uncertain.heading_deg) == (0.5, 4.0)
    vertical = read_attitude("altitude=45,roll=-3,tilt_sigma=1")
    assert vertical.kind == "up"
    np.testing.assert_allclose(vertical.rows[0], Pointing(77, 45, -3).R_cam[:, 2], atol=1e-15)
    assert read_attitude("unknown") is None
    assert read_attitude("zenith").kind == "up"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("azimuth=1,roll=2", "altitude"),
        ("altitude=1,heading_sigma=2", "azimuth"),
        ("altitude=1,altitude=2", "once"),
        ("altitude=1,pitch=2", "'pitch'"),
        ("altitude=high", "number of degrees"),
        ("altitude=100", "between -90 and 90"),
        ("altitude=1,tilt_sigma=-1", "tilt_deg"),
        ("azimuth=3,altitude=90,tilt_sigma=0.5", "heading_sigma too"),
        ("zenith,tilt_sigma=1", "altitude=90,tilt_sigma=1"),
        ("zenith-north-up,heading_sigma=1", "a name takes no sigmas"),
        ("no-such-file.json", "cannot read"),
    ],
)
def test_a_malformed_option_is_refused(text, message) -> None:
    with pytest.raises(AttitudeError, match=message):
        read_attitude(text)


@pytest.mark.parametrize("text", ["zenit", "pitch=3", "no-such-file.json"])
def test_what_is_no_file_is_told_what_the_option_may_be(text) -> None:
    with pytest.raises(AttitudeError) as told, naming_attitudes(text):
        read_attitude(text)
    message = str(told.value)
    assert message.startswith(f"cannot read attitude file {text}")
    assert "zenith, zenith-north-up" in message
    assert "azimuth=, altitude=, roll=" in message
    assert all(f"{key}=" in message for key in ATTITUDE_KEYS)
    for name in ATTITUDE_NAMES:
        read_attitude(name, up=(0.0, 0.0, 1.0))


def test_a_file_that_exists_keeps_its_own_message(tmp_path) -> None:
    with pytest.raises(AttitudeError, match=r"Is a directory$"), naming_attitudes(str(tmp_path)):
        read_attitude(str(tmp_path))
