"""Paths and inertial truth, against published gravity, the Earth's rotation, and strapdown integration of the readings."""

from __future__ import annotations

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from scipy.spatial.transform import Rotation

from generator.imu.table import mean_readings
from generator.places.trajectory import Knots, Trajectory
from generator.places.wgs84 import SEMI_MAJOR_M, SEMI_MINOR_M, normal_gravity_m_s2
from generator.scenario.model import Pointing, pointing_matrix, pointing_of
from generator.scenario.sequences.path_file import knots_of

EARTH_RAD_S = 7.292115e-5
A, E2 = 6378137.0, 6.69437999014e-3  # WGS84, NIMA TR8350.2


def still(latitude_deg: float, height_m: float = 0.0, **pointing: float) -> Trajectory:
    attitude = Rotation.from_matrix(
        pointing_matrix(Pointing(**({"azimuth_deg": 0.0, "altitude_deg": 0.0} | pointing)))[None]
    )
    return Trajectory(Knots(np.zeros(1), np.array([latitude_deg]), np.array([4.36]), np.array([height_m]), attitude))


def flight() -> Trajectory:
    """A climbing turn at the speed of a small aircraft, with the camera turning about all axes, across the date line."""
    time = np.array([0.0, 15.0, 30.0, 45.0, 60.0])
    columns = {
        "t_s": time,
        "latitude_deg": 52 + 2e-4 * time,
        "longitude_deg": 179.99 + 8e-4 * time - 3e-6 * (time - 20) ** 2,
        "height_m": 300 + 0.05 * time**2,
        "azimuth_deg": 350 + 1.5 * time,
        "altitude_deg": 80 - 0.2 * time,
        "roll_deg": 10 * np.sin(time / 20),
    }
    return Trajectory(knots_of(columns, None, Pointing(azimuth_deg=0.0, altitude_deg=90.0)))


def ecef(trajectory: Trajectory, time: np.ndarray) -> np.ndarray:
    """Earth-fixed positions by the textbook's formula from latitude, longitude and height."""
    latitude_deg, longitude_deg, height = trajectory.position(time)
    phi, lam = np.radians(latitude_deg), np.radians(longitude_deg)
    n = A / np.sqrt(1 - E2 * np.sin(phi) ** 2)
    return np.stack(
        [
            (n + height) * np.cos(phi) * np.cos(lam),
            (n + height) * np.cos(phi) * np.sin(lam),
            (n * (1 - E2) + height) * np.sin(phi),
        ],
        axis=-1,
    )


def gravitation(position: np.ndarray) -> np.ndarray:
    """The Earth's attraction from the potential's J2 (m/s^2): Vallado, Fundamentals of Astrodynamics, equation 8-30."""
    gm, j2, radius = 3.986004418e14, 1.0826298e-3, np.linalg.norm(position)
    x, y, z = position
    squeeze = 1.5 * j2 * (A / radius) ** 2
    level = 1 - squeeze * (5 * z**2 / radius**2 - 1)
    return -gm / radius**3 * np.array([x * level, y * level, z * (1 - squeeze * (5 * z**2 / radius**2 - 3))])


@pytest.mark.parametrize(
    ("latitude_deg", "published"),
    # GRS80 by Moritz 2000, J. Geodesy 74, 128; WGS84's ellipsoid differs by 1.5 micrometres per second squared.
    [(0.0, 9.7803267715), (45.0, 9.806199203), (90.0, 9.8321863685), (-45.0, 9.806199203)],
)
def test_camera_at_rest_feels_published_normal_gravity(latitude_deg, published) -> None:
    force = still(latitude_deg).specific_force_m_s2(np.zeros(1))[0]
    assert np.linalg.norm(force) == pytest.approx(published, abs=2e-6)
    assert force / np.linalg.norm(force) == pytest.approx([0, -1, 0], abs=1e-9)  # up in the image: towards the zenith


def test_normal_gravity_falls_with_height_as_attraction_and_rotation_say() -> None:
    """Against the J2 field plus centrifugal acceleration, whose neglect of J4 costs up to 1.2e-4 m/s^2."""
    for latitude_deg, height_m in ((0.0, 10_000.0), (52.0, 3_000.0), (80.0, 20_000.0)):
        trajectory = still(latitude_deg, height_m)
        position = ecef(trajectory, np.zeros(1))[0]
        total = gravitation(position) + EARTH_RAD_S**2 * position * [1, 1, 0]
        gravity = float(normal_gravity_m_s2(np.array([latitude_deg]), np.array([height_m]))[0])
        assert gravity == pytest.approx(np.linalg.norm(total), abs=1.3e-4)
        free_air = 3.086e-6 * height_m  # per metre, to the percent
        assert normal_gravity_m_s2(np.array([latitude_deg]), np.zeros(1))[0] - gravity == pytest.approx(
            free_air, rel=0.01
        )


def test_camera_at_rest_turns_with_the_earth() -> None:
    rate = still(52.0, azimuth_deg=0.0, altitude_deg=52.0).rate_rad_s(np.zeros(1))[0]
    assert rate == pytest.approx([0, 0, EARTH_RAD_S], abs=1e-15)  # the boresight is at the pole
    rate = still(52.0, azimuth_deg=90.0, altitude_deg=0.0).rate_rad_s(np.zeros(1))[0]
    # Looking east, x is south, y is down.
    expected = EARTH_RAD_S * np.array([-np.cos(np.radians(52)), -np.sin(np.radians(52)), 0])
    assert rate == pytest.approx(expected, abs=1e-15)


def test_pointing_and_rotation_are_inverses_everywhere() -> None:
    random = np.random.default_rng(1)
    for azimuth, altitude, roll in random.uniform([-360, -90, -180], [360, 90, 180], (50, 3)):
        matrix = pointing_matrix(Pointing(azimuth_deg=azimuth, altitude_deg=altitude, roll_deg=roll))
        assert pointing_matrix(pointing_of(matrix)) == pytest.approx(matrix, abs=1e-14)
        columns = {"t_s": np.zeros(1), "azimuth_deg": np.array([azimuth]), "altitude_deg": np.array([altitude])}
        columns["roll_deg"] = np.array([roll])
        knots = knots_of(
            columns | dict.fromkeys(("latitude_deg", "longitude_deg", "height_m"), np.zeros(1)), None, None
        )
        assert knots.R_cam.as_matrix()[0] == pytest.approx(matrix, abs=1e-14)
    zenith = pointing_matrix(Pointing(azimuth_deg=180.0, altitude_deg=90.0, roll_deg=30.0))
    assert pointing_of(zenith).roll_deg == pytest.approx(30)


def test_path_meets_its_knots_and_stays_on_the_geodesic() -> None:
    columns = {"t_s": np.array([0.0, 100.0]), "latitude_deg": np.array([52.0, 52.1]), "height_m": np.full(2, 500.0)}
    columns["longitude_deg"] = np.array([179.95, -179.95])
    trajectory = Trajectory(knots_of(columns, None, Pointing(azimuth_deg=0.0, altitude_deg=90.0)))
    time = np.linspace(0, 100, 21)
    latitude_deg, longitude_deg, height_m = trajectory.position(time)
    line = Geodesic.WGS84.InverseLine(52.0, 179.95, 52.1, -179.95)
    assert np.allclose(height_m, 500)
    for moment, latitude, longitude in zip(time, latitude_deg, longitude_deg, strict=True):
        on_line = line.Position(line.s13 * moment / 100)
        assert Geodesic.WGS84.Inverse(on_line["lat2"], on_line["lon2"], latitude, longitude)["s12"] < 0.05
    speed = np.linalg.norm(trajectory.velocity_enu_m_s(time), axis=1)
    assert speed == pytest.approx(line.s13 * (1 + 500 / SEMI_MAJOR_M) / 100, rel=1e-4)


def test_velocity_is_the_rate_of_the_position() -> None:
    trajectory, time, step = flight(), np.linspace(1, 59, 30), 1e-3
    before, after = ecef(trajectory, time - step), ecef(trajectory, time + step)
    speed = np.linalg.norm((after - before) / (2 * step), axis=1)
    assert np.linalg.norm(trajectory.velocity_enu_m_s(time), axis=1) == pytest.approx(speed, abs=1e-4)
    assert trajectory.velocity_enu_m_s(time)[:, 2] == pytest.approx(0.1 * time, abs=1e-4)


def test_readings_integrate_to_the_path_and_the_attitude() -> None:
    """Strapdown navigation in inertial axes (Savage 1998, J. Guidance 21, 19), with two-sample coning and sculling terms.

    It starts at the true state and meets the true attitude to 1e-8 rad, velocity and position to the step's error, in a field
    of attraction of its own.
    """
    trajectory, rate_hz = flight(), 100.0
    ends = np.arange(1, 6001) / rate_hz
    rate, force = mean_readings(trajectory, ends, 1 / rate_hz)

    def earth(time: float) -> Rotation:
        return Rotation.from_rotvec([0, 0, EARTH_RAD_S * time])

    times = np.array([0.0, ends[-1]])
    position = [earth(t).apply(place) for t, place in zip(times, ecef(trajectory, times), strict=True)]
    nudge = 1e-3
    velocity = []
    for t in times:
        ahead, back = (earth(t + s).apply(ecef(trajectory, np.array([t + s]))[0]) for s in (nudge, -nudge))
        velocity.append((ahead - back) / (2 * nudge))
    cam_from_inertial = [cam * earth(t).inv() for t, cam in zip(times, trajectory.cam_from_ecef(times), strict=True)]

    attitude, v, x, step = cam_from_inertial[0], velocity[0], position[0], 1 / rate_hz
    last_angle, last_push = rate[0] * step, force[0] * step
    for angle, push in zip(rate * step, force * step, strict=True):
        turn = angle + np.cross(last_angle, angle) / 12
        kick = push + np.cross(angle, push) / 2 + (np.cross(last_angle, push) + np.cross(last_push, angle)) / 12
        acceleration = attitude.inv().apply(kick) / step + gravitation(x + v * step / 2)
        x = x + v * step + acceleration * step**2 / 2
        v = v + acceleration * step
        attitude = Rotation.from_rotvec(-turn) * attitude
        last_angle, last_push = angle, push
    assert (attitude * cam_from_inertial[1].inv()).magnitude() < 1e-8
    # Over a minute, the difference between the J2 field and normal gravity (1e-4 m/s^2) adds up to so much.
    assert v == pytest.approx(velocity[1], abs=1e-2)
    assert x == pytest.approx(position[1], abs=0.3)


def test_rates_alone_without_any_correction_reproduce_the_attitude() -> None:
    trajectory, rate_hz = flight(), 200.0
    ends = np.arange(1, 12001) / rate_hz
    rate, _ = mean_readings(trajectory, ends, 1 / rate_hz)
    start, end = trajectory.cam_from_ecef(np.array([0.0, ends[-1]]))
    attitude = start
    for turn in Rotation.from_rotvec(-rate / rate_hz):
        attitude = turn * attitude
    expected = end * Rotation.from_rotvec([0, 0, EARTH_RAD_S * ends[-1]]).inv()
    assert (attitude * expected.inv()).magnitude() < 1e-6


def test_ellipsoid_is_wgs84() -> None:
    assert pytest.approx(6356752.3142, abs=1e-4) == SEMI_MINOR_M
