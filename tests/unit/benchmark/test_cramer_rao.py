"""The Cramér-Rao bound: against published limits, sums over pixels, finite differences, Monte Carlo and celnav."""

import dataclasses
import json
import math

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import erf
from unit.benchmark.fake_night import write_dataset

from benchmark.fields.solver_bars import solve_field
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, make_field
from benchmark.frames.dataset import open_dataset
from benchmark.judge.cramer_rao import (
    EXACT,
    VERTICAL,
    Prior,
    bound_km,
    median_error_km,
    position_bound,
    position_information,
)
from benchmark.judge.frame_bounds import bound_of, light_of
from benchmark.judge.geodesy import geodesic_km
from benchmark.judge.place_information import (
    StarLight,
    background_variance,
    centroid_information,
    place_information,
    streak_information,
    streak_share,
)
from benchmark.protocol import CameraRecord

SEED = 1618
FALSE_ALARM = 1e-4


def rng_for(*key):
    return np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=key))


def one(value):
    return np.array([float(value)])


def test_limits_that_are_published():
    """King (1983): sigma^2 / E for photons alone, 8 pi sigma^4 b / E^2 where the background rules."""
    variance = 0.9**2 + 1 / 12
    photons = 1 / centroid_information(one(1e6), one(1e-6), 0.9)[0]
    assert photons == pytest.approx(variance / 1e6, rel=1e-4)
    background = 1 / centroid_information(one(1.0), one(1e4), 0.9)[0]
    assert background == pytest.approx(8 * math.pi * variance**2 * 1e4, rel=1e-4)
    # No step where the series takes over.
    e = 2 * math.pi * variance / np.array([49.999, 50.001])
    assert np.ptp(centroid_information(e, np.ones(2), 0.9) * np.array([49.999, 50.001]) ** 2) < 1e-3


def pixel_model(e, s, at, reach=12):
    """Expected electrons in pixels and their derivative by u, summed over pixels exactly."""
    edges = np.arange(-reach, reach + 2) - 0.5

    def share(middle):
        return np.diff(0.5 * erf((edges - middle) / (math.sqrt(2) * s)))

    slope = (share(at[0] + 1e-5) - share(at[0] - 1e-5)) / 2e-5
    return e * np.outer(share(at[1]), share(at[0])), e * np.outer(share(at[1]), slope)


@pytest.mark.parametrize("sigma_px", [0.5, 0.8, 1.5])
@pytest.mark.parametrize(("e", "b"), [(200.0, 50.0), (1e4, 2.0), (500.0, 10.0)])
def test_information_is_that_of_the_pixels(sigma_px, e, b):
    """Averaged over where in a pixel the star lies; the pixel's width as 1/12 px^2 is good to 2 %."""
    summed = []
    for u in np.linspace(-0.5, 0.5, 10, endpoint=False):
        mean, slope = pixel_model(e, sigma_px, (u, 0.2))
        summed.append(np.sum(slope**2 / (mean + b)))
    assert np.mean(summed) == pytest.approx(centroid_information(one(e), one(b), sigma_px)[0], rel=0.02)


def test_information_along_and_across_a_streak():
    e, b, s = 3000.0, 20.0, 0.8
    for length in (0.3, 2.0, 12.0, 40.0):
        along, across = streak_information(one(e), one(b), s, one(length))[0]
        # A streak cut into many short steps, summed over fine cells.
        cell = 0.1
        x, y = np.meshgrid(np.arange(-length / 2 - 6, length / 2 + 6, cell), np.arange(-6, 6, cell))
        sigma = math.sqrt(s**2 + 1 / 12)
        steps = np.linspace(-0.5, 0.5, 400) * length
        profile = sum(np.exp(-((x - step) ** 2 + y**2) / (2 * sigma**2)) for step in steps)
        mean = e * profile / (2 * math.pi * sigma**2 * len(steps))
        slopes = np.gradient(mean, cell)
        sums = [float(np.sum(slope**2 / (mean + b)) * cell**2) for slope in (slopes[1], slopes[0])]
        assert (along, across) == pytest.approx(sums, rel=0.02)
    assert streak_information(one(e), one(b), s, one(0.05))[0] == pytest.approx(
        [centroid_information(one(e), one(b), s)[0]] * 2, rel=2e-3
    )


@pytest.mark.parametrize(("e", "b"), [(3e5, 1e-4), (3000.0, 20.0), (5.0, 4000.0)])
def test_information_of_a_streak_is_its_integral_over_the_plane(e, b):
    """From light alone to background alone: SciPy's adaptive quadrature in two dimensions."""
    s, length = 0.9, 7.0
    sigma = math.sqrt(s**2 + 1 / 12)

    def density(x, y, axis):
        step = [(x + sign * length / 2) / sigma for sign in (1, -1)]
        along = (erf(step[0] / math.sqrt(2)) - erf(step[1] / math.sqrt(2))) / (2 * length)
        slope = (stats.norm.pdf(step[0]) - stats.norm.pdf(step[1])) / (sigma * length)
        across = stats.norm.pdf(y / sigma) / sigma
        gradient = (slope, along * y / sigma**2)[axis] * e * across
        return gradient**2 / (e * along * across + b)

    reach = 6 * sigma
    expected = [
        4 * integrate.dblquad(density, 0, reach, 0, length / 2 + reach, args=(axis,), epsrel=1e-6)[0] for axis in (0, 1)
    ]
    assert streak_information(one(e), one(b), s, one(length))[0] == pytest.approx(expected, rel=2e-5)
    dark = streak_information(one(e), one(0), s, one(length))[0]
    assert dark == pytest.approx(streak_information(one(e), one(1e-9 * e), s, one(length))[0], rel=1e-5)
    assert (streak_information(one(0), one(b), s, one(length)) == 0).all()
    # A star without light states no background.
    assert np.isnan(streak_information(one(0), one(math.nan), s, one(length))).all()


def test_information_of_streaks_is_interpolated_between_its_integrals():
    rng = rng_for(3)
    variance = 0.7**2 + 1 / 12
    for length in np.exp(rng.uniform(math.log(0.06), math.log(5000), 100)):
        light = np.exp(rng.uniform(math.log(1e-7), math.log(1e11), 20))
        expected = light[:, None] * streak_share(light, length)
        lengths = np.full(20, length * math.sqrt(variance))
        found = streak_information(light * variance, np.ones(20), 0.7, lengths)
        assert found == pytest.approx(expected, rel=1e-5)


def test_information_of_a_slanted_streak_has_its_axes_along_and_across():
    light, _, _ = random_sky(5, n=2)
    streaks = np.array([[3.0, 4.0], [-6.0, 2.0]])
    found = place_information(dataclasses.replace(light, streak_px=streaks))
    lengths = np.hypot(*streaks.T)
    expected = streak_information(light.electrons_e, light.background_e2, light.psf_sigma_px, lengths)
    for information, (u, v), length, (along, across) in zip(found, streaks, lengths, expected, strict=True):
        axes = np.array([[u, v], [-v, u]]) / length
        assert axes @ information @ axes.T == pytest.approx(np.diag([along, across]), rel=1e-9, abs=1e-9 * across)
        assert along < 0.9 * across


def test_an_efficient_estimator_of_a_place_reaches_the_bound():
    """Maximum likelihood by scoring on simulated pixels: variance over bound is 1 within the chi^2 interval of the trials."""
    e, b, s, trials = 4000.0, 15.0, 0.9, 4000
    rng = rng_for(1)
    at = np.array([0.17, -0.23])
    mean, slope_u = pixel_model(e, s, at)
    slope_v = pixel_model(e, s, at[::-1])[1].T
    seen = rng.poisson(mean, (trials, *mean.shape)) + rng.normal(0, math.sqrt(b), (trials, *mean.shape))
    design = np.stack((slope_u, slope_v)).reshape(2, -1) / (mean.ravel() + b)
    information = design @ np.stack((slope_u, slope_v)).reshape(2, -1).T
    found = np.linalg.solve(information, design @ (seen - mean).reshape(trials, -1).T)
    ratio = found.var(axis=1, ddof=1) * centroid_information(one(e), one(b), s)[0]
    low, high = stats.chi2.ppf([FALSE_ALARM / 4, 1 - FALSE_ALARM / 4], trials - 1) / (trials - 1)
    assert ((ratio > low - 0.02) & (ratio < high + 0.02)).all()  # 2 %: the star is at one place in its pixel


CAMERA = CameraRecord("pinhole", WIDTH, HEIGHT, 400.0, 400.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)


def random_sky(seed, n=30, tilt_deg=15.0, latitude=35.0, longitude=-70.0):
    """Stars as directions fixed to the Earth, and a camera near the zenith."""
    rng = rng_for(2, seed)
    tilt, heading = math.radians(tilt_deg), rng.uniform(0, 2 * math.pi)
    c, s = math.cos(heading), math.sin(heading)
    zenith = np.array([[-c, s, 0.0], [-s, -c, 0.0], [0.0, 0.0, 1.0]])
    R_cam = np.array([[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]) @ zenith
    uv = rng.uniform([20, 20], [WIDTH - 20, HEIGHT - 20], (n, 2))
    rays = np.column_stack(((uv[:, 0] - CAMERA.cx_px) / 400, (uv[:, 1] - CAMERA.cy_px) / 400, np.ones(n)))
    enu = rays @ R_cam / np.linalg.norm(rays, axis=1)[:, None]
    light = StarLight(
        uv, 10 ** rng.uniform(2.5, 4.5, n), np.full(n, 30.0), np.zeros((n, 2)), 0.8, CAMERA, R_cam, latitude
    )
    return light, enu @ local_axes(latitude, longitude), (latitude, longitude)


def local_axes(latitude, longitude):
    """Rows: east, north, up in Earth-fixed axes."""
    p, q = math.radians(latitude), math.radians(longitude)
    return np.array([
        [-math.sin(q), math.cos(q), 0],
        [-math.sin(p) * math.cos(q), -math.sin(p) * math.sin(q), math.cos(p)],
        [math.cos(p) * math.cos(q), math.cos(p) * math.sin(q), math.sin(p)],
    ])  # fmt: skip


def places(earth_fixed, position, R_cam, turn=(0.0, 0.0, 0.0), lens=(0.0, 0.0, 0.0)):
    """Pixels of the stars seen from a position by a camera whose attitude in local axes is R_cam after a small turn.

    Its lens is off by a relative focal length and by a shift of the principal point, px.
    """
    enu = earth_fixed @ local_axes(*position).T
    enu = enu + np.cross(np.radians(turn), enu)
    x, y, z = (enu @ R_cam.T).T
    f_px, (cx_px, cy_px) = 400 * (1 + lens[0]), np.array([CAMERA.cx_px, CAMERA.cy_px]) + lens[1:]
    return np.column_stack((cx_px + f_px * x / z, cy_px + f_px * y / z)).ravel()


def finite_differences(light, earth_fixed, position):
    """Derivatives of all places by km east and north (lengths by the geodesic), by degrees of three turns and by the lens."""
    h = 1e-4
    lat, lon = position
    columns = []
    for step in ((0.0, h), (h, 0.0)):
        ahead, behind = (lat + step[0], lon + step[1]), (lat - step[0], lon - step[1])
        change = places(earth_fixed, ahead, light.R_cam) - places(earth_fixed, behind, light.R_cam)
        columns.append(change / geodesic_km(*behind, *ahead))
    for axis in np.eye(3):
        change = places(earth_fixed, position, light.R_cam, h * axis) - places(
            earth_fixed, position, light.R_cam, -h * axis
        )
        columns.append(change / (2 * h))
    for unit in np.eye(3):
        change = places(earth_fixed, position, light.R_cam, lens=h * unit) - places(
            earth_fixed, position, light.R_cam, lens=-h * unit
        )
        columns.append(change / (2 * h))
    return np.column_stack(columns)


PRIORS = {
    "exact": EXACT,
    "vertical": VERTICAL,
    "sigmas": Prior(0.02, 0.5),
    "tilt": Prior(tilt_deg=0.1),
    "lens": Prior(0.0, math.inf, 1e-3, 0.3),
    "unknown lens": Prior(0.05, 3.0, math.inf, math.inf),
}


@pytest.mark.parametrize("latitude", [35.0, -78.0, 0.0])
@pytest.mark.parametrize("kind", PRIORS)
def test_information_by_finite_differences(kind, latitude):
    """The whole chain anew: stars fixed to the Earth, positions moved along geodesics, the attitude's error in the model."""
    prior = PRIORS[kind]
    light, earth_fixed, position = random_sky(1, latitude=latitude)
    design = finite_differences(light, earth_fixed, position)
    weights = np.repeat(place_information(light)[:, 0, 0], 2)
    full = design.T @ (weights[:, None] * design)
    point = prior.principal_point_px
    sigmas = np.array([prior.tilt_deg, prior.tilt_deg, prior.heading_deg, prior.focal, point, point])
    keep = [0, 1, *(2 + np.flatnonzero(sigmas > 0))]
    full = full[np.ix_(keep, keep)]
    full[range(2, len(keep)), range(2, len(keep))] += 1 / sigmas[sigmas > 0] ** 2
    assert position_bound(light, prior) == pytest.approx(np.linalg.inv(full)[:2, :2], rel=2e-4)


@pytest.mark.parametrize("kind", ["exact", "vertical"])
def test_an_efficient_solver_reaches_the_bound(kind):
    """Weighted least squares on places with the noise the bound assumes: the error's covariance is the bound."""
    light, earth_fixed, position = random_sky(2)
    design = finite_differences(light, earth_fixed, position)
    design = design[:, [0, 1]] if kind == "exact" else design[:, [0, 1, 4]]
    weights = np.repeat(place_information(light)[:, 0, 0], 2)
    trials = 4000
    noise = rng_for(3, len(kind)).standard_normal((trials, len(weights))) / np.sqrt(weights)
    solved = np.linalg.solve(design.T @ (weights[:, None] * design), design.T @ (weights[:, None] * noise.T))[:2]
    whitened = np.linalg.solve(np.linalg.cholesky(position_bound(light, PRIORS[kind])), solved)
    low, high = stats.chi2.ppf([FALSE_ALARM / 4, 1 - FALSE_ALARM / 4], trials - 1) / (trials - 1)
    assert ((whitened.var(axis=1, ddof=1) > low) & (whitened.var(axis=1, ddof=1) < high)).all()
    assert abs(np.corrcoef(whitened)[0, 1]) < stats.norm.isf(FALSE_ALARM / 2) / math.sqrt(trials)


def test_celnav_claims_about_the_bound_on_clean_fields():
    """Its covariance, from residuals, against the bound for centroids of the same noise: within 15 % in the middle."""
    noise_px = 0.15
    ratios, errors = [], []
    for exact in (True, False):
        condition = Condition("clean", noise_px=noise_px, exact_attitude=exact, v_max=5.0, tilt_deg=10.0)
        for number in range(6):
            field = make_field(condition, 99, number)
            fix = solve_field(condition, field)
            n = len(field.uv)
            # A star whose photons alone give the noise: E / s^2 = 1 / noise^2.
            light = StarLight(
                field.uv, np.full(n, (0.8**2 + 1 / 12) / noise_px**2), np.full(n, 1e-9), np.zeros((n, 2)), 0.8,
                CameraRecord("pinhole", WIDTH, HEIGHT, condition.f_px, condition.f_px, (WIDTH - 1) / 2, (HEIGHT - 1) / 2),
                field.R_cam, field.lat_deg,
            )  # fmt: skip
            bound = bound_km(light, EXACT if exact else VERTICAL)
            assert fix.ok
            ratios.append(math.sqrt(np.trace(fix.cov_km2)) / bound)
            errors.append(geodesic_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg) / bound)
    assert 0.85 < np.median(ratios) < 1.15
    assert all(0.6 < ratio < 1.6 for ratio in ratios)
    # Twelve errors at the bound: the sum of their squares is between chi^2 of 12 and of 24 degrees of freedom, halved.
    assert np.mean(np.square(errors)) < 1.15**2 * stats.chi2.isf(FALSE_ALARM, 12) / 12


def test_knowing_less_never_helps():
    light, _, _ = random_sky(3)
    chain = [EXACT, Prior(0.0, 0.01), Prior(0.0, 1.0), VERTICAL, Prior(0.01, math.inf)]
    bounds = [bound_km(light, prior) for prior in chain]
    assert bounds == sorted(bounds)
    # A tilt of 0.01 degrees about each axis alone is 1.11 km east and north.
    assert bounds[-1] == pytest.approx(math.hypot(1.11, 1.11), rel=0.01)
    assert bound_km(light, Prior(math.inf, math.inf)) == math.inf
    nothing = dataclasses.replace(
        light, uv=light.uv[:0], electrons_e=light.electrons_e[:0], background_e2=light.background_e2[:0],
        streak_px=light.streak_px[:0],
    )  # fmt: skip
    assert bound_km(nothing) == math.inf
    streaked = dataclasses.replace(light, streak_px=np.full((len(light.uv), 2), 4.0))
    assert bound_km(streaked) > bound_km(light)
    outside = dataclasses.replace(light, uv=light.uv + 5000)
    assert (position_information(outside) == 0).all()


@pytest.mark.parametrize("seed", range(40))
def test_one_star_and_a_vertical_give_a_circle_and_no_position(seed):
    """Without the heading one star holds one direction of the position; what rounding leaves of the other is nothing."""
    light, _, _ = random_sky(seed, n=1)
    light = dataclasses.replace(light, electrons_e=np.full(1, 1e7))
    for prior in (VERTICAL, Prior(0.0, math.inf, 1e-4, 0.2), Prior(0.01, math.inf, math.inf, 0.0)):
        assert np.isinf(position_bound(light, prior)).all()
    fainter = dataclasses.replace(light, electrons_e=np.full(1, 1e5))
    assert np.isfinite(position_bound(fainter, Prior(0.0, 5.0))).all()


def test_a_shift_of_a_narrow_field_is_as_good_as_a_turn():
    """A star tracker that looks up: 0.2 px of 53 arcsec are 10.6 arcsec, along each axis a displacement of the same angle."""
    f_px, rng = math.degrees(3600) / 53, rng_for(8)
    uv, n = rng.uniform(300, 700, (40, 2)), 40
    light = StarLight(
        uv, np.full(n, 1e4), np.ones(n), np.zeros((n, 2)), 1.0,
        CameraRecord("pinhole", 1024, 1024, f_px, f_px, 511.5, 511.5), np.eye(3), 0.0,
    )  # fmt: skip
    told = position_bound(light, Prior(heading_deg=math.inf, principal_point_px=0.2))
    # 10.6 arcsec of the radii of curvature at the equator, 6378.1 km east and 6335.4 km north: stars known to 0.01 px do not
    # tell a shift from a turn.
    by_angle = np.radians(10.6 / 3600) * np.array([6378.1, 6335.4])
    assert np.sqrt(np.diag(told)) == pytest.approx(by_angle, rel=0.02)


def test_the_median_of_a_gaussian_error():
    """Rayleigh's median for a circle, the normal distribution's for a line, and random draws between the two."""
    assert median_error_km(9.0 * np.eye(2)) == pytest.approx(3.0 * math.sqrt(2.0 * math.log(2.0)), rel=1e-9)
    assert median_error_km(np.diag([1e-4, 4.0])) == pytest.approx(2.0 * stats.norm.ppf(0.75), rel=1e-3)
    covariance = np.array([[2.0, 1.1], [1.1, 1.0]])
    draws = rng_for(7).multivariate_normal(np.zeros(2), covariance, 40_000)
    below = np.count_nonzero(np.hypot(*draws.T) < median_error_km(covariance))
    assert stats.binomtest(below, len(draws), 0.5).pvalue > FALSE_ALARM
    assert median_error_km(np.full((2, 2), math.inf)) == math.inf


def test_the_background_is_that_in_the_ratio():
    area = 4 * math.pi * (0.8**2 + 1 / 12)
    e, b = np.array([10.0, 1e3, 1e5]), np.array([40.0, 5.0, 100.0])
    assert background_variance(e, e / np.sqrt(e + area * b), 0.8) == pytest.approx(b, rel=1e-6)
    assert np.isnan(background_variance(one(0), one(0), 0.8)).all()


def test_the_bound_of_a_frame_on_disk(tmp_path):
    folder = write_dataset(tmp_path / "night", (1,))
    (frame,) = open_dataset(folder).frames
    assert bound_of(frame) is None
    path = frame.image_path.with_suffix(".json")
    record = json.loads(path.read_text())
    record["optics"] = {"psf_sigma_px": 1.0}
    path.write_text(json.dumps(record))
    bound = bound_of(frame)
    assert bound is not None
    assert bound == pytest.approx(bound_km(light_of(frame)))
    unsure = dataclasses.replace(frame.observation, focal_sigma=0.01, principal_point_sigma_px=0.2)
    prior = Prior(focal=0.01, principal_point_px=0.2)
    assert bound_of(dataclasses.replace(frame, observation=unsure)) == pytest.approx(bound_km(light_of(frame), prior))
    # What a solver is told wrongly changes what it can know, not where the stars are.
    told = dataclasses.replace(frame.observation, R_cam=np.eye(3), tilt_sigma_deg=0.1, heading_sigma_deg=math.inf)
    misled = dataclasses.replace(frame, observation=told)
    assert np.array_equal(light_of(misled).R_cam, light_of(frame).R_cam)
    assert bound_of(misled) == pytest.approx(math.hypot(11.1, 11.1), rel=0.1)
