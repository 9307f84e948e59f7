"""Whatever it is given, the solver answers within a second, with a refusal or a typed error, never with a wrong claim."""

import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import celnav

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
UTC = "2020-01-01T00:00:00Z"
ATTITUDES = (None, celnav.Attitude.up([0, 0, 1]), celnav.Attitude.zenith_north_up())
LIMIT_S = 1.0


def timed(detections, attitude, **options):
    start = time.thread_time()
    fix = celnav.solve(detections, CAMERA, UTC, attitude, **options)
    assert time.thread_time() - start < LIMIT_S
    return fix


@pytest.fixture(scope="module", autouse=True)
def _tables():
    rng = np.random.default_rng(0)
    celnav.solve(rng.uniform(0, 700, (40, 2)), CAMERA, UTC, None)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    uv=arrays(np.float64, st.tuples(st.integers(0, 40), st.just(2)), elements=st.floats(0, 719, width=32)),
    attitude=st.sampled_from(ATTITUDES),
    with_flux=st.booleans(),
)
def test_arbitrary_positions_are_refused(uv, attitude, with_flux):
    flux = np.arange(len(uv), dtype=float) if with_flux else None
    fix = timed(uv, attitude, flux=flux)
    assert not fix.ok
    assert fix.reason in {"too_few_detections", "no_hypothesis", "inconsistent"}
    assert np.isnan(fix.lat_deg)


@settings(max_examples=12, deadline=None)
@given(uv=arrays(np.float64, (6, 2), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_any_number_is_an_error_or_a_refusal(uv):
    usable = np.isfinite(uv).all() and CAMERA.in_frame(uv, 54.0).all()
    if usable:
        assert not timed(uv, None).ok
    else:
        with pytest.raises(celnav.CelnavError):
            timed(uv, None)


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize("n", [5000])
@pytest.mark.parametrize("with_flux", [True, False])
def test_clutter_alone_is_refused(attitude, n, with_flux):
    rng = np.random.default_rng(n)
    fix = timed(rng.uniform([0, 0], [1079, 719], (n, 2)), attitude, flux=rng.random(n) if with_flux else None)
    assert fix.reason == "no_hypothesis"


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_few_and_degenerate(attitude):
    line = np.column_stack((np.linspace(0, 1079, 60), np.linspace(0, 719, 60)))
    lattice = np.column_stack([axis.ravel() for axis in np.meshgrid(np.arange(0, 1080, 90.0), np.arange(0, 720, 90.0))])
    for uv in (np.empty((0, 2)), [[5.0, 5.0]], np.full((300, 2), 77.0), line, lattice):
        assert timed(uv, attitude).reason in {"too_few_detections", "no_hypothesis"}


def test_malformed_questions():
    uv = np.random.default_rng(1).uniform(0, 700, (30, 2))
    for call, text in (
        (lambda: celnav.solve(uv, CAMERA, "2150-01-01T00:00:00Z", None), "Earth rotation"),
        (lambda: celnav.solve(uv, celnav.Camera.pinhole(100, 80, 60), UTC, None), "outside"),
        (lambda: celnav.solve(celnav.Detections(uv, None, None, np.zeros(30)), CAMERA, UTC, None), "sigma_px"),
        (lambda: celnav.LastKnown(95, 0, 10), "Earth"),
        (lambda: celnav.LastKnown(5, 0, 0), "radius"),
        (lambda: celnav.SkybenchConfig(calibrate="always"), "calibrate"),
    ):
        with pytest.raises(celnav.CelnavError, match=text) as caught:
            call()
        assert "\n" not in str(caught.value)


@settings(max_examples=6, deadline=None)
@given(
    n=st.integers(2, 400),
    angle=st.floats(0, 6.28),
    offset=st.floats(-300, 300),
    seed=st.integers(0, 1000),
    attitude=st.sampled_from(ATTITUDES),
)
def test_stars_on_a_line_are_refused(n, angle, offset, seed, attitude):
    along = np.random.default_rng(seed).uniform(-500, 500, n)
    direction, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    uv = [539.5, 359.5] + along[:, None] * direction + offset * across
    uv = uv[CAMERA.in_frame(uv)]
    assert timed(uv, attitude).reason in {"too_few_detections", "no_hypothesis"}


@settings(max_examples=6, deadline=None)
@given(
    n=st.integers(1000, 30_000),
    with_flux=st.booleans(),
    attitude=st.sampled_from(ATTITUDES),
    model=st.sampled_from(["pinhole", "equidistant", "stereographic"]),
)
def test_thousands_of_false_detections_are_refused(n, with_flux, attitude, model):
    rng = np.random.default_rng(n)
    camera = celnav.Camera(model=model, width=1080, height=720, f_px=350.0)
    start = time.thread_time()
    flux = rng.random(n) if with_flux else None
    fix = celnav.solve(rng.uniform([0, 0], [1079, 719], (n, 2)), camera, UTC, attitude, flux=flux)
    assert time.thread_time() - start < LIMIT_S
    assert fix.reason == "no_hypothesis"


@settings(max_examples=10, deadline=None)
@given(width=st.integers(16, 700), height=st.integers(16, 500))
def test_detections_of_a_larger_camera_are_an_error(width, height):
    uv = np.random.default_rng(1).uniform([0, 0], [1079, 719], (60, 2))
    with pytest.raises(celnav.errors.CameraError, match="outside"):
        celnav.solve(uv, celnav.Camera.pinhole(width, height, 60), UTC, None)
    with pytest.raises(celnav.errors.CameraError, match="image"):
        celnav.solve(celnav.Detections(uv, None, (720, 1080)), celnav.Camera.pinhole(1081, 720, 60), UTC, None)


@settings(max_examples=10, deadline=None)
@given(year=st.integers(1, 9998).filter(lambda year: not 1973 <= year <= 2027))
def test_times_without_earth_orientation_are_an_error(year):
    uv = np.random.default_rng(1).uniform([0, 0], [1079, 719], (60, 2))
    with pytest.raises(celnav.CelnavError):
        celnav.solve(uv, CAMERA, f"{year:04d}-06-01T00:00:00Z", None)
