"""A lens whose axis is off, and a vertical calibrated with it: frames that are combined doubt it as one frame does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import celnav
from benchmark.judge.geodesy import east_north_km
from celnav.position import Weather
from celnav.sequences.known_orientation import Orientation, solve_oriented
from celnav.sky.astrometry import apparent_enu, enu_rotation
from celnav.sky.catalog import load_catalog
from celnav.sky.utc import Utc, parse_utc
from celnav.uncertainty.contradicted import vertical_doubt_deg

TOLD = celnav.Camera.pinhole(1080, 720, 90)
TRUE = replace(TOLD, cx_px=TOLD.cx_px + 20, cy_px=TOLD.cy_px + 10)
PLACE = 51.883, -1.306
START = parse_utc("2022-09-14T20:00:00Z")
R_CAM = Rotation.from_euler("ZXZ", [40, 20, 20], degrees=True).as_matrix() @ np.diag([-1.0, -1.0, 1.0])
# The axis through the middle of the frame, which the calibration with the told lens takes for the boresight.
OFF = Rotation.align_vectors(TOLD.to_rays([[540.0, 360.0]]), TRUE.to_rays([[540.0, 360.0]]))[0].as_matrix()
UP = celnav.Attitude.up(OFF @ R_CAM[:, 2], tilt_deg=0.01)


def stars(seconds, camera=TRUE, R_cam=R_CAM):
    """Positions and fluxes of the stars to V 5 with a noise of 0.3 px."""
    catalog = load_catalog()
    catalog = catalog.take(catalog.v_mag < 5.0)
    utc = Utc(START.mjd_day, START.second_of_day_s + seconds)
    enu = apparent_enu(catalog, utc, *PLACE, pressure_hpa=1010.0, temperature_c=10.0)
    uv = camera.project(enu @ R_cam.T)
    seen = (enu[:, 2] > 0.2) & np.isfinite(uv[:, 0]) & camera.in_frame(np.nan_to_num(uv, nan=-1e9), -2.0)
    uv = uv[seen] + 0.3 * np.random.default_rng(int(seconds)).standard_normal((int(seen.sum()), 2))
    return uv, 10 ** (-0.4 * catalog.v_mag[seen]), utc


def offset_and_square(found):
    error = np.array(east_north_km(*PLACE, found.lat_deg, found.lon_deg))
    return float(np.hypot(*error)), float(error @ np.linalg.solve(found.cov_km2, error)) / 2


def test_a_night_doubts_its_vertical_once() -> None:
    night = celnav.Night(TOLD, UP)
    for seconds in (0, 1800, 3600):
        uv, flux, utc = stars(seconds)
        night.add(uv, utc, flux=flux)
    assert all(1 < vertical_doubt_deg(fix) < 5 for fix in night.fixes)
    found = night.fix()
    for answer in (night.fixes[0], found):
        offset, square = offset_and_square(answer)
        assert 150 < offset < 300
        assert 0.1 < square < 3
    assert found.latitude_deg.sigma > 1


def test_cameras_doubt_their_verticals_and_mountings() -> None:
    uv, flux, utc = stars(0)
    alone = celnav.solve_cameras([celnav.CameraView(uv, TOLD, UP, flux=flux)], utc)
    offset, square = offset_and_square(alone)
    assert 150 < offset < 300
    assert 0.1 < square < 3
    on_body = celnav.CameraView(uv, TOLD, None, OFF, flux=flux)
    mounted = celnav.solve_cameras([on_body], utc, celnav.Attitude.up(R_CAM[:, 2], tilt_deg=0.01))
    offset, square = offset_and_square(mounted)
    assert 150 < offset < 300
    assert 0.1 < square < 3


def test_another_camera_outweighs_a_vertical_in_doubt() -> None:
    uv, flux, utc = stars(0)
    right_uv, right_flux, _ = stars(0, TOLD)
    views = [
        celnav.CameraView(uv, TOLD, UP, np.eye(3), 0.05, flux=flux),
        celnav.CameraView(
            right_uv, TOLD, celnav.Attitude.up(R_CAM[:, 2], tilt_deg=0.05), np.eye(3), 0.05, flux=right_flux
        ),
    ]
    found = celnav.solve_cameras(views, utc)
    offset, square = offset_and_square(found)
    assert offset < 15
    assert square < 3


def test_a_frame_searched_near_the_others_doubts_its_vertical_too() -> None:
    uv, flux, utc = stars(0)
    known = Orientation(R_CAM @ enu_rotation(*PLACE), 1e-4, *PLACE)
    fix = solve_oriented(uv, TOLD, utc, UP, known, "skybench", Weather(), flux)
    offset, square = offset_and_square(fix)
    assert 150 < offset < 300
    assert 0.1 < square < 3


def test_a_lens_that_holds_puts_nothing_in_doubt() -> None:
    uv, flux, utc = stars(0, TOLD)
    fix = celnav.solve(uv, TOLD, utc, celnav.Attitude.up(R_CAM[:, 2], tilt_deg=0.01), flux=flux)
    assert fix.ok
    assert "vertical_doubt_deg" not in fix.details
    assert vertical_doubt_deg(fix) == pytest.approx(0)
