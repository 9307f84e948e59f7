"""Headings near the poles: an honest attitude passes at any latitude, a wrong one does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import celnav
from celnav.camera import Camera
from celnav.horizon import Place, heading_contradicts, honest_place
from celnav.sky.astrometry import celestial_to_terrestrial, enu_rotation
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

LATITUDES = [90.0, -90.0, 88.0, -85.0, 78.0, 66.0]
# Tilt and heading, deg.
SIGMAS = [(0.0, 0.0), (0.001, 0.01), (0.5, 0.5), (2.0, 1.0), (0.5, 0.0)]
STARS_RAD = np.radians(0.005)
CAMERA = Camera.pinhole(1200, 900, 60)
UTC = "2023-03-10T21:00:00Z"


def turned(vector_deg):
    return Rotation.from_rotvec(np.radians(vector_deg)).as_matrix()


def limit_deg(tilt_deg, heading_deg):
    return max(1 + 5 * heading_deg, 5.0 if tilt_deg else 0.0)


def place_of(lat_deg, rng, tilt_deg, heading_deg, off_deg=(0.0, 0.0, 0.0)):
    """Place from a random camera whose attitude is told with errors of those sigmas, and `off_deg` beyond them."""
    true = Rotation.random(random_state=rng).as_matrix()
    told = true @ turned(rng.normal(0, [tilt_deg, tilt_deg, heading_deg])) @ turned(off_deg)
    by_stars = turned(np.degrees(rng.normal(0, STARS_RAD, 3))) @ true @ enu_rotation(lat_deg, rng.uniform(-180, 180))
    attitude = celnav.Attitude.with_sigma(told, tilt_deg=tilt_deg, heading_deg=heading_deg)
    return honest_place(by_stars, np.eye(3) * STARS_RAD**2, attitude)


@pytest.mark.parametrize("lat_deg", LATITUDES)
@pytest.mark.parametrize("sigmas", SIGMAS)
def test_honest_attitudes_pass_at_any_latitude(lat_deg, sigmas) -> None:
    rng = np.random.default_rng(11)
    places = [place_of(lat_deg, rng, *sigmas) for _ in range(100)]
    assert not any(heading_contradicts(place, limit_deg(*sigmas)) for place in places)


@pytest.mark.parametrize("lat_deg", [0.0, 45.0, 78.0, 88.0])
def test_what_no_position_explains_is_chi_squared(lat_deg) -> None:
    """The mean of 400 is 1 within 4 of its standard deviations, 0.28."""
    rng = np.random.default_rng(12)
    found = [place_of(lat_deg, rng, 0.1, 0.3).chi2 for _ in range(400)]
    assert abs(np.mean(found) - 1) < 0.28


@pytest.mark.parametrize("lat_deg", [0.0, 45.0, 60.0, 70.0])
@pytest.mark.parametrize("sigmas", SIGMAS[:3])
def test_wrong_headings_are_contradicted(lat_deg, sigmas) -> None:
    rng = np.random.default_rng(13)
    off = 2 * limit_deg(*sigmas) / min(1.0, 2 * np.cos(np.radians(lat_deg)))
    places = [place_of(lat_deg, rng, *sigmas, off_deg=(0, 0, off)) for _ in range(20)]
    assert all(heading_contradicts(place, limit_deg(*sigmas)) for place in places)


def test_limit_counts_in_full_up_to_sixty_degrees() -> None:
    def of(lat_deg, heading_off_deg, chi2=1e4):
        return heading_contradicts(Place(lat_deg, 0.0, np.eye(2), heading_off_deg, chi2), 1.0)

    for lat_deg in (-60, 0, 45, 60):
        assert of(lat_deg, 1.001)
        assert of(lat_deg, -1.001)
        assert not of(lat_deg, 0.999)
    assert not of(80, 2.8)  # 2 cos 80 deg = 0.347
    assert of(80, 2.9)
    assert not of(0, 50.0, chi2=25.0)
    assert not of(0, float("nan"))


def positions(lat_deg, lon_deg, R_cam, rng):
    """Positions of the catalogue's stars to V 5.5 without air and aberration, px, and their flux."""
    stars = load_catalog()
    stars = stars.take(np.flatnonzero(stars.v_mag < 5.5))
    instant = parse_utc(UTC)
    enu = stars.vectors @ celestial_to_terrestrial(instant, earth_orientation(instant)).T
    enu = enu @ enu_rotation(lat_deg, lon_deg).T
    uv = CAMERA.project(enu @ R_cam.T)
    seen = (enu[:, 2] > 0.05) & np.isfinite(uv[:, 0])
    seen[seen] &= CAMERA.in_frame(uv[seen])
    return uv[seen] + rng.normal(0, 0.2, (int(seen.sum()), 2)), 10 ** (-0.4 * stars.v_mag[seen])


@pytest.mark.parametrize("lat_deg", [90.0, -90.0, 86.0])
def test_frames_and_nights_near_a_pole_are_solved(lat_deg) -> None:
    rng = np.random.default_rng(14)
    for tilt, heading in ((0.0, 0.0), (0.5, 0.5)):
        R_cam = celnav.Pointing(rng.uniform(0, 360), 60, 20).R_cam
        uv, flux = positions(lat_deg, 30.0, R_cam, rng)
        told = R_cam @ turned(rng.normal(0, [tilt, tilt, heading]))
        attitude = celnav.Attitude.with_sigma(told, tilt_deg=tilt, heading_deg=heading)
        night = celnav.Night(CAMERA, attitude=attitude, pressure_hpa=0)
        fix = night.add(celnav.Detections(uv, flux), UTC)
        assert fix.ok, fix.message
        assert night.fix().ok


def test_a_night_says_why_its_frames_are_refused() -> None:
    """A heading 30 deg off is a contradiction: the frames are identified, and the night does not deny it."""
    rng = np.random.default_rng(15)
    R_cam = celnav.Pointing(120, 60, 20).R_cam
    uv, flux = positions(40.0, 30.0, R_cam, rng)
    told = celnav.Attitude.with_sigma(R_cam @ turned((0, 0, 30)), tilt_deg=0.5, heading_deg=0.5)
    night = celnav.Night(CAMERA, attitude=told, pressure_hpa=0)
    night.add(celnav.Detections(uv, flux), UTC)
    found = night.fix()
    assert found.reason == "inconsistent"
    assert "heading" in found.message
