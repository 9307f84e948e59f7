"""Whatever it is given, the solver answers within its bound of work, with a refusal or a typed error, never with a claim."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import celnav

CAMERA = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
UTC = "2020-01-01T00:00:00Z"
ATTITUDES = (None, celnav.Attitude.up([0, 0, 1]), celnav.Attitude.zenith_north_up())
MAX_WORK = celnav.SkybenchConfig().max_work
NOT_IDENTIFIED = {"no_hypothesis", "effort_spent"}


def refused(detections, attitude, camera=CAMERA, **options):
    """Solve; the work is within the bound, and most of it is spent where that is the reason."""
    fix = celnav.solve(detections, camera, UTC, attitude, **options)
    assert not fix.ok
    assert np.isnan(fix.lat_deg)
    assert fix.work <= MAX_WORK
    return fix


@settings(max_examples=12, deadline=None)
@given(
    uv=arrays(np.float64, st.tuples(st.integers(0, 40), st.just(2)), elements=st.floats(0, 719, width=32)),
    attitude=st.sampled_from(ATTITUDES),
    with_flux=st.booleans(),
)
def test_arbitrary_positions_are_refused(uv, attitude, with_flux):
    flux = np.arange(len(uv), dtype=float) if with_flux else None
    assert refused(uv, attitude, flux=flux).reason in NOT_IDENTIFIED | {"too_few_detections", "inconsistent"}


@settings(max_examples=12, deadline=None)
@given(uv=arrays(np.float64, (6, 2), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_any_number_is_an_error_or_a_refusal(uv):
    usable = np.isfinite(uv).all() and CAMERA.in_frame(uv, 54.0).all()
    if usable:
        refused(uv, None)
    else:
        with pytest.raises(celnav.CelnavError):
            celnav.solve(uv, CAMERA, UTC, None)


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize("with_flux", [True, False])
def test_clutter_alone_spends_the_effort(attitude, with_flux):
    rng = np.random.default_rng(5000)
    uv, flux = rng.uniform([0, 0], [1079, 719], (5000, 2)), rng.random(5000) if with_flux else None
    fix = refused(uv, attitude, flux=flux)
    assert fix.reason == "effort_spent"
    assert "max_work" in fix.message


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_few_and_degenerate(attitude):
    line = np.column_stack((np.linspace(0, 1079, 60), np.linspace(0, 719, 60)))
    lattice = np.column_stack([axis.ravel() for axis in np.meshgrid(np.arange(0, 1080, 90.0), np.arange(0, 720, 90.0))])
    for uv in (np.empty((0, 2)), [[5.0, 5.0]], np.full((300, 2), 77.0), line, lattice):
        assert refused(uv, attitude).reason in NOT_IDENTIFIED | {"too_few_detections"}


def test_malformed_questions():
    uv = np.random.default_rng(1).uniform(0, 700, (30, 2))
    for call, text in (
        (lambda: celnav.solve(uv, CAMERA, "2150-01-01T00:00:00Z", None), "Earth rotation"),
        (lambda: celnav.solve(uv, celnav.Camera.pinhole(100, 80, 60), UTC, None), "outside"),
        (lambda: celnav.solve(celnav.Detections(uv, None, None, np.zeros(30)), CAMERA, UTC, None), "sigma_px"),
        (lambda: celnav.LastKnown(95, 0, 10), "lat_deg"),
        (lambda: celnav.LastKnown(5, 0, 0), "radius"),
        (lambda: celnav.SkybenchConfig(calibrate="always"), "calibrate"),
        (lambda: celnav.SkybenchConfig(max_work=0), "max_work"),
        (lambda: celnav.SkybenchConfig(focal_effort=0.5), "focal_effort"),
        (lambda: celnav.SkybenchConfig(time_limit_s=-1.0), "time_limit_s"),
        (lambda: celnav.solve(uv, CAMERA, UTC, None, time_limit_s=0.0), "time_limit_s"),
        (lambda: celnav.solve(uv, CAMERA, UTC, np.eye(3), "thesis-adaptive", time_limit_s=9.0), "no time limit"),
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
    assert refused(uv, attitude).reason in NOT_IDENTIFIED | {"too_few_detections"}


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
    flux = rng.random(n) if with_flux else None
    fix = refused(rng.uniform([0, 0], [1079, 719], (n, 2)), attitude, camera, flux=flux)
    assert fix.reason in NOT_IDENTIFIED


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
