"""The one function that makes a position of an attitude: against ERFA's whole chain, and against celnav's own fix."""

import erfa
import numpy as np
import pytest

import celnav
from benchmark.judge.geodesy import geodesic_km
from benchmark.solvers.attitude_position import position_of_attitude
from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog, propagate
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

PLACES = [(52.0, 4.36), (-41.29, 174.78), (0.5, -78.5), (78.2, 15.6), (-77.8, 166.7)]
UTC = "2021-03-20T22:15:07.25Z"


def best_rotation(catalogue, camera):
    """Rotation that takes unit vectors `catalogue`, shape (n, 3), nearest to `camera` (Wahba's problem by SVD)."""
    u, _, vt = np.linalg.svd(camera.T @ catalogue)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def oblique_camera(zenith_angle_deg):
    """Rotation ENU to a camera that looks so far from the zenith, towards an azimuth of 70 deg."""
    azimuth, altitude = np.radians([70.0, 90.0 - zenith_angle_deg])
    boresight = np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])
    right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    return np.array([right, np.cross(boresight, right), boresight])


@pytest.mark.parametrize("place", PLACES)
def test_against_erfas_chain_from_catalogue_to_observed_place(place):
    # A round field of 50 deg that looks past the zenith, without air: where ERFA sees catalogue directions from this place.
    lat, lon = place
    utc = parse_utc(UTC)
    orientation = earth_orientation(utc)
    jd1, jd2 = erfa.dtf2d("UTC", 2021, 3, 20, 22, 15, 7.25)
    R_cam = oblique_camera(20.0)
    turn, radius = np.meshgrid(np.radians(np.arange(0.0, 360.0, 30.0)), np.radians([5.0, 10.0, 15.0, 20.0, 25.0]))
    in_camera = np.column_stack(
        ((np.sin(radius) * np.cos(turn)).ravel(), (np.sin(radius) * np.sin(turn)).ravel(), np.cos(radius).ravel())
    )
    enu = in_camera @ R_cam
    azimuth, zenith_angle = np.arctan2(enu[:, 0], enu[:, 1]), np.arccos(enu[:, 2])
    site = (
        orientation.dut1_s, np.radians(lon), np.radians(lat), 0.0,
        np.radians(orientation.xp_arcsec / 3600), np.radians(orientation.yp_arcsec / 3600), 0.0, 0.0, 0.0, 0.55,
    )  # fmt: skip
    ra, dec = erfa.atoc13("A", azimuth, zenith_angle, jd1, jd2, *site)
    catalogue = np.column_stack((np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)))
    rotation = best_rotation(catalogue, in_camera)
    found = position_of_attitude(rotation, R_cam[:, 2], UTC)
    # Left out: diurnal aberration, at most 10 m, and what the annual one does to a field beside turning it.
    assert geodesic_km(lat, lon, *found) < 0.03


@pytest.mark.parametrize("place", PLACES)
def test_against_celnav_on_exact_positions_of_stars(place):
    lat, lon = place
    camera = celnav.Camera.pinhole(1080, 720, 60.0)
    R_cam = oblique_camera(20.0)
    stars = load_catalog()
    stars = stars.take(np.flatnonzero(stars.v_mag < 5.5))
    enu = apparent_enu(stars, UTC, lat, lon, pressure_hpa=0.0)
    uv = camera.project(enu @ R_cam.T)
    seen = np.isfinite(uv[:, 0]) & camera.in_frame(np.nan_to_num(uv, nan=-1e6)) & (enu[:, 2] > 0)
    uv, flux = uv[seen], 10.0 ** (-0.4 * stars.v_mag[seen])
    fix = celnav.solve(uv, camera, UTC, celnav.Attitude.up(R_cam[:, 2]), flux=flux, pressure_hpa=0.0)
    assert fix.ok
    catalogue = propagate(stars.vectors, stars.motion, 2021.215 - stars.epoch_jyear)
    catalogue /= np.linalg.norm(catalogue, axis=1, keepdims=True)
    found = position_of_attitude(best_rotation(catalogue[seen], camera.to_rays(uv)), R_cam[:, 2], UTC)
    # Stars are not spread evenly over the field, so that what they take in of aberration is not quite the boresight's.
    assert geodesic_km(fix.lat_deg, fix.lon_deg, *found) < 0.05
    assert geodesic_km(lat, lon, *found) < 0.05


@pytest.mark.parametrize(
    ("rotation", "up", "message"),
    [
        (np.eye(2), [0, 0, 1], "not a rotation"),
        (np.full((3, 3), np.nan), [0, 0, 1], "not a rotation"),
        (np.diag([1.0, 1.0, -1.0]), [0, 0, 1], "reflection"),
        (np.eye(3), [0, 0, 0], "not a direction"),
        (np.eye(3), [0, 1], "not a direction"),
    ],
)
def test_what_is_no_attitude_is_refused(rotation, up, message):
    with pytest.raises(ValueError, match=message):
        position_of_attitude(rotation, up, UTC)
