"""The one function that makes a position of an attitude: against ERFA's whole chain, and against celnav's own fix."""

import dataclasses

import erfa
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import celnav
from benchmark.judge.geodesy import geodesic_km
from benchmark.protocol import CameraRecord, Observation
from benchmark.solvers.attitude_position import (
    best_rotation,
    covariance_of_attitude,
    position_of_attitude,
    rays_of_fit,
)
from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog, propagate
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.utc import parse_utc

PLACES = [(52.0, 4.36), (-41.29, 174.78), (0.5, -78.5), (78.2, 15.6), (-77.8, 166.7)]
UTC = "2021-03-20T22:15:07.25Z"


def oblique_camera(zenith_angle_deg):
    """Rotation ENU to a camera that looks so far from the zenith, towards an azimuth of 70 deg."""
    azimuth, altitude = np.radians([70.0, 90.0 - zenith_angle_deg])
    boresight = np.array([np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)])
    right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    return np.array([right, np.cross(boresight, right), boresight])


@pytest.mark.parametrize("pressure_hpa", [0.0, 1010.0])
@pytest.mark.parametrize("place", PLACES)
def test_against_erfas_chain_from_catalogue_to_observed_place(place, pressure_hpa):
    # A round field of 50 deg that looks past the zenith: where ERFA sees catalogue directions from this place, through air.
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
        np.radians(orientation.xp_arcsec / 3600), np.radians(orientation.yp_arcsec / 3600), pressure_hpa, 10.0, 0.5, 0.55,
    )  # fmt: skip
    ra, dec = erfa.atoc13("A", azimuth, zenith_angle, jd1, jd2, *site)
    catalogue = np.column_stack((np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)))
    rotation = best_rotation(catalogue, in_camera)
    found = position_of_attitude(rotation, R_cam[:, 2], UTC, in_camera, pressure_hpa, 10.0)
    # Left out: diurnal aberration, at most 10 m.
    assert geodesic_km(lat, lon, *found) < 0.012
    if pressure_hpa:
        # Refraction lifts this field by 20 arcsec: without taking it off the fix is off by as much.
        assert (
            0.4 < geodesic_km(lat, lon, *position_of_attitude(rotation, R_cam[:, 2], UTC, in_camera, 0.0, 10.0)) < 1.0
        )


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
    rays = camera.to_rays(uv)
    found = position_of_attitude(best_rotation(catalogue[seen], rays), R_cam[:, 2], UTC, rays, 0.0, 10.0)
    assert geodesic_km(fix.lat_deg, fix.lon_deg, *found) < 0.02
    assert geodesic_km(lat, lon, *found) < 0.02


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
        position_of_attitude(rotation, up, UTC, np.eye(3), 0.0, 10.0)


def test_too_few_directions_are_refused():
    with pytest.raises(ValueError, match="3 directions or more"):
        position_of_attitude(np.eye(3), [0, 0, 1], UTC, np.eye(3)[:2], 0.0, 10.0)


@pytest.mark.parametrize("model", ["pinhole", "equidistant"])
def test_without_named_stars_the_frame_stands_for_them(model):
    camera = CameraRecord(model, 640, 480, 200.0, 200.0, 319.5, 239.5)
    up = oblique_camera(60.0)[:, 2]
    grid = rays_of_fit(camera, np.empty((0, 2)), up)
    assert len(grid) > 20
    assert (grid @ up > 0.04).all(), "keeps to the sky"
    named = np.array([[10.0, 20.0], [600.0, 100.0], [300.0, 400.0]])
    np.testing.assert_allclose(rays_of_fit(camera, named, up), celnav.Camera(model, 640, 480, 200.0).to_rays(named))


def test_the_covariance_of_an_attitude_is_that_of_the_positions_that_it_gives():
    """Its linear map is that of small turns of the camera, each made by itself."""
    told = Observation(CameraRecord("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5), UTC, oblique_camera(30.0))
    rotation = best_rotation(np.eye(3), oblique_camera(70.0))
    rays = rays_of_fit(told.camera, np.empty((0, 2)), told.R_cam[:, 2])
    place = position_of_attitude(rotation, told.R_cam[:, 2], UTC, rays, 0.0, 10.0)
    root = 1e-4 * np.array([[2.0, 0.0, 0.0], [0.5, 1.0, 0.0], [-1.0, 0.3, 3.0]])
    by_turn = []
    for turn in 1e-5 * np.eye(3):
        # The camera turns: what stood still before it turns back.
        turned = Rotation.from_rotvec(turn).as_matrix().T @ rotation
        lat, lon = position_of_attitude(turned, told.R_cam[:, 2], UTC, rays, 0.0, 10.0)
        by_turn.append(np.radians([(lon - place[1]) * np.cos(np.radians(place[0])), lat - place[0]]) * 6371.0 / 1e-5)
    stated = covariance_of_attitude(root @ root.T, rotation, place, told)
    expected = np.array(by_turn).T @ root @ root.T @ np.array(by_turn)
    np.testing.assert_allclose(stated, expected, rtol=0.01, atol=0.01 * np.trace(expected))
    vertical = covariance_of_attitude(root @ root.T, rotation, place, dataclasses.replace(told, tilt_sigma_deg=0.1))
    np.testing.assert_allclose(vertical - stated, np.eye(2) * (6371.0 * np.radians(0.1)) ** 2, atol=1e-9)
