"""Time, lens, air and attitude told with errors: covariances hold, and the search reaches as far as the errors do.

Fields are ERFA's (`benchmark.fields`). Everything that a solver is told is drawn from the standard deviations that it is
told. Squared errors over their covariance then sum up to chi-squared of two degrees of freedom a field.
"""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

import celnav
from benchmark.fields.solver_bars import camera_of
from benchmark.fields.solver_fields import PRESSURE_HPA, TEMPERATURE_C, Condition, make_field
from benchmark.judge.geodesy import east_north_km
from benchmark.protocol import SIGMAS, Answer, CameraRecord, Observation
from benchmark.solvers import celnav_solver
from benchmark.solvers.messages import request_of
from benchmark.solvers.serve import serve
from celnav.command.sigma_option import read_sigmas
from celnav.errors import ConfigError
from celnav.uncertainty.refraction_errors import RELATIVE_SIGMA

SEED = 5
WIDE = Condition("120 deg", noise_px=0.2)
TILTED = Condition("60 deg", 60, 7, noise_px=0.2, tilt_deg=40)
FISHEYE = Condition("180 deg", 180, 5, noise_px=0.2, equidistant=True)
ROUGH = celnav.ToldSigmas(utc_s=0.5, focal=1e-3, centre_px=1.0, pressure_hpa=2.0, temperature_c=2.0)
FALSE_ALARM = 1e-3


def solve_drawn(condition, number, sigmas, tilt_deg, heading_deg, told=True):
    """Error, east and north (km), and the fix of a field of which all that is told is drawn from the sigmas."""
    field, rng = make_field(condition, SEED, number), np.random.default_rng([SEED, number, 9])
    camera = camera_of(condition)
    f_px = camera.f_px * math.exp(sigmas.focal * rng.normal())
    cx, cy = np.array([camera.cx_px, camera.cy_px]) + rng.normal(0, sigmas.centre_px, 2)
    camera = replace(camera, f_px=f_px, fy_px=f_px, cx_px=cx, cy_px=cy)
    tilt = Rotation.from_rotvec([*rng.normal(0, tilt_deg, 2), 0.0], degrees=True)
    turn = rng.uniform(-180, 180) if math.isinf(heading_deg) else rng.normal(0, heading_deg)
    R_cam = field.R_cam @ (tilt * Rotation.from_rotvec([0, 0, turn], degrees=True)).as_matrix()
    attitude = celnav.Attitude.up(R_cam[:, 2], tilt_deg)
    if math.isfinite(heading_deg):
        attitude = celnav.Attitude.with_sigma(R_cam, tilt_deg=tilt_deg, heading_deg=heading_deg)
    utc = (datetime.fromisoformat(field.utc) + timedelta(seconds=sigmas.utc_s * rng.normal())).isoformat()
    # The air along the way differs from the observer's besides.
    hpa = PRESSURE_HPA * (1 + RELATIVE_SIGMA * rng.normal()) + sigmas.pressure_hpa * rng.normal()
    fix = celnav.solve(
        field.uv, camera, utc, attitude, flux=field.flux, pressure_hpa=hpa,
        temperature_c=TEMPERATURE_C + sigmas.temperature_c * rng.normal(), sigmas=sigmas if told else None,
    )  # fmt: skip
    off = east_north_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg) if fix.ok else (math.nan, math.nan)
    return np.array(off), fix


@pytest.mark.parametrize("condition", [WIDE, TILTED, FISHEYE], ids=lambda c: c.name)
@pytest.mark.parametrize(
    ("sigmas", "tilt_deg", "heading_deg"),
    [
        (ROUGH, 0.005, 0.2),
        (celnav.ToldSigmas(0.02, 3e-4, 0.3, 2.0, 2.0), 0.005, math.inf),
        (celnav.ToldSigmas(0.001, 1e-3, 10.0, 2.0, 2.0), 0.03, 2.0),
    ],
    ids=["by hand, 1 px", "NTP, 0.3 px", "GNSS, 10 px"],
)
def test_covariances_hold_what_is_told(condition, sigmas, tilt_deg, heading_deg):
    """Twelve fields: the sum of squares is chi-squared of 24, but for one run in a thousand."""
    squares = []
    for number in range(12):
        off, fix = solve_drawn(condition, number, sigmas, tilt_deg, heading_deg)
        assert fix.ok, fix.message
        squares.append(off @ np.linalg.solve(fix.cov_km2, off))
    least, most = chdtri(24, [1 - FALSE_ALARM / 2, FALSE_ALARM / 2])
    assert least < sum(squares) < most


def test_what_is_not_told_is_missed():
    """A principal point that is off by a pixel, and not said to be: 14 km instead of one, and beyond the covariance."""
    told, silent = ([solve_drawn(WIDE, n, ROUGH, 0.005, 0.2, said) for n in range(12)] for said in (True, False))
    errors = [np.median([np.hypot(*off) for off, _ in of]) for of in (told, silent)]
    assert errors[0] < 2.0 < 5.0 < errors[1]
    assert sum(off @ np.linalg.solve(fix.cov_km2, off) for off, fix in silent) > chdtri(24, 1e-6)


def test_a_focal_length_within_ten_per_cent_is_found():
    """Drawn with 10 % (1 sigma): the camera as given and two factors reach 17 %, those of the told sigma 30 %."""
    wide = celnav.ToldSigmas(focal=0.1)
    fixes = [solve_drawn(WIDE, number, wide, 0.005, math.inf)[1] for number in range(8)]
    assert all(fix.ok for fix in fixes)
    camera = camera_of(WIDE)
    assert wide.focal_factors((0.88, 1.13), camera) == pytest.approx(np.exp([-0.12, 0.12, -0.24, 0.24]))
    assert celnav.ToldSigmas(focal=0.01).focal_factors((0.88, 1.13), camera) == (0.88, 1.13)


def solve_distorted(number, sigma, told):
    """k1, drawn with a standard deviation, its value in the fix, and the fix's error, km; the lens is told as a pinhole."""
    field, camera = make_field(TILTED, SEED, number), camera_of(TILTED)
    k1 = sigma * np.random.default_rng([SEED, number, 11]).normal()
    centre = np.array([camera.cx_px, camera.cy_px])
    away = field.uv - centre
    uv = centre + away * (1 + k1 * np.einsum("ni,ni->n", away, away) / camera.f_px**2)[:, None]
    fix = celnav.solve(
        uv, camera, field.utc, celnav.Attitude.with_sigma(field.R_cam, tilt_deg=0.005, heading_deg=0.2), flux=field.flux,
        pressure_hpa=PRESSURE_HPA, temperature_c=TEMPERATURE_C,
        sigmas=celnav.ToldSigmas(distortion=sigma) if told else None,
    )  # fmt: skip
    assert fix.ok, fix.message
    half_diagonal = math.hypot(camera.width, camera.height) / 2
    found = math.nan if fix.calibration.q1 is None else fix.calibration.q1.value * (camera.f_px / half_diagonal) ** 2
    return k1, found, math.hypot(*east_north_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg))


def test_a_distortion_that_is_told_to_be_unknown_is_found():
    """k1 of 0.1 (1 sigma) moves the corners of 60 x 42 deg by 5 %; with 0.2 px of noise it is found to 0.005."""
    told, silent = (np.array([solve_distorted(n, 0.1, said) for n in range(8)]) for said in (True, False))
    assert np.abs(told[:, 1] - told[:, 0]).max() < 0.005 < 0.05 < np.abs(told[:, 0]).max()
    assert 2 * np.median(told[:, 2]) < np.median(silent[:, 2])


def test_the_search_takes_half_of_the_corners_distortion_for_a_focal_length():
    """A square of 90 deg has its corners at r^2 = 2: k1 of 0.1 moves them by 20 %; the search covers thrice half of it."""
    camera = celnav.Camera.from_dict({"model": "pinhole", "width": 1000, "height": 1000, "f_px": 500.0})
    assert celnav.ToldSigmas(distortion=0.1).distortion_at_corner(camera) == pytest.approx(0.2, rel=0.01)
    likewise = celnav.ToldSigmas(focal=0.1).focal_factors((), camera)
    assert celnav.ToldSigmas(distortion=0.1).focal_factors((), camera) == pytest.approx(likewise)


@pytest.mark.parametrize("solver", ["skybench", "thesis-adaptive"])
def test_a_second_is_465_metres_at_the_equator(solver):
    """The Earth's surface moves by 465.1 m/s at the equator, and by the cosine of the latitude less (WGS84)."""
    field = make_field(Condition("exact", exact_attitude=True, tilt_deg=0), SEED, 3)
    plain, late = (
        celnav.solve(
            field.uv, camera_of(WIDE), field.utc, field.R_cam, solver, flux=field.flux, sigmas=celnav.ToldSigmas(utc_s=s)
        ).cov_km2
        for s in (0.0, 10.0)
    )  # fmt: skip
    added = late - plain
    lat = math.radians(field.lat_deg)
    # The ellipsoid's parallel is wider than a sphere's by up to 0.34 %.
    assert math.sqrt(added[0, 0]) == pytest.approx(4.651 * math.cos(lat) * (1 + 0.00336 * math.sin(lat) ** 2), rel=1e-3)
    assert added[0, 1] == added[1, 1] == 0.0


def test_warm_air_refracts_less():
    """3 K of 300, or 10 hPa of 1000, are one per cent of the refraction (Green 1985)."""
    for told in (celnav.ToldSigmas(temperature_c=3.0), celnav.ToldSigmas(pressure_hpa=10.0)):
        assert told.refraction(1000.0, 26.85) == pytest.approx(0.01)


def test_every_solver_is_told_alike(monkeypatch):
    """Sigmas go from the frame's observation through the request to the solver; celnav's adapter hands them on."""
    values = {
        "utc_sigma_s": 0.5,
        "focal_sigma": 1e-3,
        "principal_point_sigma_px": 0.3,
        "pressure_sigma_hpa": 2.0,
        "temperature_sigma_c": 3.0,
        "distortion_sigma": 0.01,
    }
    assert values.keys() == set(SIGMAS)
    camera = CameraRecord("pinhole", 1080, 720, 312.0, 312.0, 540.0, 360.0)
    seen = Observation(camera, "2022-01-01T00:00:00Z", np.eye(3), 0.01, math.inf, 900.0, -5.0, **values)
    frame = SimpleNamespace(frame_id="a", observation=seen)
    shared = celnav.Detections(np.array([[1.0, 2.0]]), np.array([3.0]), (720, 1080))
    got = []

    class Listener:
        name, version, detector = "listener", "1", "none"

        def solve(self, detections, observation):
            got.append(observation)
            return Answer(ok=False, reason="listened")

    request = request_of(frame, shared, Path("image.png"))
    serve(Listener(), io.BytesIO(json.dumps(request).encode() + b"\n"), io.BytesIO())
    assert {name: getattr(got[0], name) for name in SIGMAS} == values
    given = {}
    monkeypatch.setattr(
        celnav, "solve", lambda *_, **named: given.update(named) or celnav.Fix.refusal(celnav.Reason.OK, "")
    )
    celnav_solver.CelnavSolver("skybench").solve(shared, got[0])
    assert given["sigmas"] == celnav.ToldSigmas(0.5, 1e-3, 0.3, 2.0, 3.0, 0.01)


def test_the_option_names_what_is_wrong():
    assert read_sigmas("time=0.5, focal=0.001,centre=1,pressure=2,temperature=2") == ROUGH
    assert read_sigmas(None) == celnav.ToldSigmas()
    assert read_sigmas("distortion=0.03") == celnav.ToldSigmas(distortion=0.03)
    for text, words in (("time", "must be a number"), ("width=1", "one of time"), ("time=1,time=2", "at most once"),
                        ("centre=-1", "from 0"), ("focal=nan", "finite")):  # fmt: skip
        with pytest.raises(ConfigError, match=words):
            read_sigmas(text)
    field = make_field(WIDE, SEED, 0)
    with pytest.raises(ConfigError, match="ToldSigmas"):
        celnav.solve(field.uv, camera_of(WIDE), field.utc, None, sigmas=0.5)
