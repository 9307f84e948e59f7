"""Windows and lamps near the horizon do not keep the stars above them from being named."""

import math

import numpy as np

import celnav
from celnav.identification.low_lights import LOW_DEG, high_detections
from celnav.sky.astrometry import apparent_enu
from celnav.sky.catalog import load_catalog
from celnav.sky.utc import parse_utc

CAMERA = celnav.Camera(model="equidistant", width=960, height=720, f_px=300)
UP = np.array([0.0, 0.0, 1.0])
UTC = parse_utc("2021-11-05T22:00:00Z")
LAT_DEG, LON_DEG = 47.0, 8.0


def at_altitudes(rng, n, lowest_deg, highest_deg):
    """Directions in the frame, even over the altitudes."""
    result = []
    while len(result) < n:
        z, azimuth = math.radians(rng.uniform(lowest_deg, highest_deg)), rng.uniform(0, 2 * math.pi)
        ray = [math.cos(z) * math.cos(azimuth), math.cos(z) * math.sin(azimuth), math.sin(z)]
        uv = CAMERA.project(np.array([ray]))
        if np.isfinite(uv).all() and CAMERA.in_frame(uv)[0]:
            result.append(ray)
    return np.array(result)


def test_low_lights_are_told_from_an_even_sky():
    rng = np.random.default_rng(1)
    crowded = np.vstack((at_altitudes(rng, 40, 0, LOW_DEG - 1), at_altitudes(rng, 9, 30, 80)))
    assert high_detections(CAMERA, crowded, UP).tolist() == list(range(40, 49))
    assert high_detections(CAMERA, crowded, None) is None
    assert high_detections(CAMERA, crowded[:43], UP) is None
    uv = np.column_stack((rng.uniform(0, 959, 300), rng.uniform(0, 719, 300)))
    assert high_detections(CAMERA, CAMERA.to_rays(uv), UP) is None


def test_stars_above_a_street_of_lights_are_named():
    """Nine stars, and 70 lights below 15 deg that are brighter than all of them; without the step it is refused."""
    rng = np.random.default_rng(2)
    stars = load_catalog()
    stars = stars.take(stars.v_mag < 2.6)
    enu = apparent_enu(stars, UTC, LAT_DEG, LON_DEG, pressure_hpa=1010.0, temperature_c=10.0)
    attitude = celnav.Attitude.zenith_north_up()
    uv = CAMERA.project(enu @ attitude.R_cam.T)
    seen = (enu[:, 2] > math.sin(math.radians(25))) & np.isfinite(uv[:, 0]) & CAMERA.in_frame(np.nan_to_num(uv, nan=-1))
    brightest = np.argsort(stars.v_mag[seen])[:9]
    true = uv[seen][brightest] + 0.3 * rng.standard_normal((9, 2))
    lights = CAMERA.project(at_altitudes(rng, 70, 0, 15))
    fix = celnav.solve(
        np.vstack((lights, true)),
        CAMERA,
        UTC,
        attitude,
        flux=np.concatenate((rng.uniform(2, 9, 70), np.linspace(1, 0.5, 9))),
    )
    assert fix.ok
    assert abs(fix.lat_deg - LAT_DEG) < 0.1
    assert abs(fix.lon_deg - LON_DEG) < 0.1


def test_clutter_alone_is_never_a_fix():
    """Low lights that crowd and 12 false ones above them, in 12 frames: no position."""
    for seed in range(12):
        rng = np.random.default_rng([3, seed])
        uv = CAMERA.project(np.vstack((at_altitudes(rng, 50, 0, 15), at_altitudes(rng, 12, 20, 85))))
        for attitude in (celnav.Attitude.zenith_north_up(), celnav.Attitude.up(UP))[: 1 + (seed == 0)]:
            assert not celnav.solve(uv, CAMERA, UTC, attitude, flux=rng.random(62)).ok
