"""Covariances under errors that single stars do not show: the wrong lens, a calibrated lens, an attitude that is off.

Fields are ERFA's (`benchmark.fields`), distorted here. Squared errors over their covariance have a mean of 2 where the
covariance is right; over n fields that mean is distributed as chi-squared of 2 n degrees of freedom over n.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from calibration_sky import LAT_DEG, LON_DEG, apparent_stars, fisheye_positions, frame_of

import celnav
from benchmark.fields.solver_bars import camera_of
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, make_field
from benchmark.judge.geodesy import east_north_km
from celnav.horizon import honest_place
from celnav.identification.verification import rotation_of
from celnav.lens.lens_uncertainty import LensUncertainty
from celnav.sky.astrometry import enu_rotation
from celnav.sky.refraction import refraction_rad
from celnav.uncertainty.shared_residuals import LEAST_SCORE, shared_field

WIDE = Condition("wide", noise_px=0.2)
CENTRE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
FIELDS = 30


def squared_error(fix, lat_deg, lon_deg):
    assert fix.ok, fix.message
    off = np.array(east_north_km(lat_deg, lon_deg, fix.lat_deg, fix.lon_deg))
    return float(off @ np.linalg.solve(fix.cov_km2, off))


def in_frame(uv):
    return ((uv > -0.5) & (uv < np.array([WIDTH, HEIGHT]) - 0.5)).all(axis=1)


def distorted(field, rng, rms_px):
    """Positions with decentring and a cubic radial term of random proportions, `rms_px` along an axis."""
    x, y = ((field.uv - CENTRE) / WIDE.f_px).T
    r2 = x * x + y * y
    (a, b), c = rng.normal(size=2), rng.normal()
    off = np.column_stack(
        (2 * a * x * y + b * (r2 + 2 * x * x) + c * x * r2, a * (r2 + 2 * y * y) + 2 * b * x * y + c * y * r2)
    )
    return field.uv + off * (rms_px / np.sqrt((off**2).mean()))


def test_a_wrong_lens_widens_the_covariance():
    """0.22 px that a lens leaves: a mean squared error of 2 to a few, where independent stars would make it above 500.

    Decentring is no Gaussian process, and most of it looks like a turn of the camera, which the residuals do not show: the
    bar is 12, and the truth must be within the 99 % ellipse in most fields.
    """
    squares = []
    for number in range(FIELDS):
        field = make_field(WIDE, 777, number)
        uv = distorted(field, np.random.default_rng([5, number]), 0.22)
        good = in_frame(uv)
        up = celnav.Attitude.up(field.R_cam[:, 2])
        fix = celnav.solve(uv[good], camera_of(WIDE), field.utc, up, flux=field.flux[good])
        squares.append(squared_error(fix, field.lat_deg, field.lon_deg))
        assert fix.details["shared_score"] > LEAST_SCORE
    assert np.mean(squares) < 12
    assert np.mean(np.array(squares) < 9.21) > 0.6


def test_independent_stars_seldom_look_alike():
    """Of frames of noise alone one in fifteen reaches the score; more than 54 of 500 do with a probability below 0.001."""
    found = 0
    for number in range(500):
        rng = np.random.default_rng([91, number])
        n = int(rng.integers(20, 600))
        uv = rng.uniform(-0.5, np.array([WIDTH, HEIGHT]) - 0.5, (n, 2))
        x, y = ((uv - CENTRE) / WIDE.f_px).T
        one = np.ones(n)
        design = WIDE.f_px * np.stack(
            (np.column_stack((x * y, one + y * y)), np.column_stack((-one - x * x, -x * y)), np.column_stack((y, -x))),
            axis=2,
        )
        sigma = rng.uniform(0.1, 0.4, n)
        residual = rng.normal(0, sigma[:, None], (n, 2))
        rows, weight = design.reshape(-1, 3), np.repeat(1 / sigma**2, 2)
        fitted = np.linalg.solve(rows.T @ (rows * weight[:, None]), rows.T @ (weight * residual.ravel()))
        off = residual - (design @ fitted)
        found += shared_field(uv, off, 1 / sigma**2, design, np.zeros(3), None, (WIDTH, HEIGHT)) is not None
    assert found <= 54


def test_the_field_that_was_put_in_is_found():
    """0.1 px alike over 0.25 half diagonals beneath 0.2 px of noise: its size is found within a third, over 20 frames."""
    rng = np.random.default_rng(4)
    half, n = np.hypot(WIDTH, HEIGHT) / 2, 500
    sizes = []
    for _ in range(20):
        uv = rng.uniform(-0.5, np.array([WIDTH, HEIGHT]) - 0.5, (n, 2))
        apart = ((uv[:, None] - uv[None]) ** 2).sum(axis=2)
        factor = np.linalg.cholesky(np.exp(-0.5 * apart / (0.25 * half) ** 2) + 1e-8 * np.eye(n))
        residual = 0.1 * factor @ rng.normal(size=(n, 2)) + rng.normal(0, 0.2, (n, 2))
        design = np.stack((np.tile([1.0, 0.0], (n, 1)), np.tile([0.0, 1.0], (n, 1))), axis=2)
        residual = residual - residual.mean(axis=0)
        shared = shared_field(uv, residual, np.full(n, 25.0), design, np.zeros(2), None, (WIDTH, HEIGHT))
        assert shared is not None
        sizes.append(shared.rms_px**2)
    assert np.sqrt(np.mean(sizes)) == pytest.approx(0.1, rel=0.33)


def test_a_calibration_s_uncertainty_enters():
    """Lenses drawn from the covariance that the solver is told, the attitude known apart from the lens.

    The mean of 20 fields lies between 0.9 and 3.6 with probability 0.997; without the covariance it is 12.
    """
    true, size = np.array([330.0, 612.0, 441.0, -0.012, 0.004, -0.003]), (1200, 900)
    names = ("f_px", "cx_px", "cy_px", "k1", "k2", "k3")
    sigmas = np.array([0.1, 0.4, 0.4, 2e-4, 1e-4, 1e-4])
    cov = np.diag(sigmas**2)
    cov[0, 3] = cov[3, 0] = -0.8 * sigmas[0] * sigmas[3]
    utc = "2021-08-05T05:30:00+00:00"
    enu, v_mag = apparent_stars(utc, 5.0)
    told, exact = [], []
    for number in range(20):
        rng = np.random.default_rng([number, 8])
        drawn = rng.multivariate_normal(np.zeros(6), cov)
        R_cam = rotation_of(rng.normal(0, 0.06, 3)) @ np.diag([-1.0, -1.0, 1.0])
        frame, _ = frame_of(
            utc,
            fisheye_positions(enu, R_cam, [*true, 0.0]),
            v_mag,
            size,
            rng,
            sigma_px=0.1,
            visible=(R_cam @ enu.T)[2] > 0,
        )
        f, cx, cy, *k = true + drawn
        plain = celnav.Camera("kannala_brandt", *size, f, cx_px=cx, cy_px=cy, k=tuple(k))
        known = replace(plain, uncertainty=LensUncertainty(names, tuple(tuple(row) for row in cov.tolist())))
        for camera, squares in ((plain, exact), (known, told)):
            solver = celnav.SkybenchSolver(celnav.SkybenchConfig(calibrate="none"))
            fix = celnav.solve(frame.detections, camera, utc, celnav.Attitude.up(R_cam[:, 2]), solver)
            squares.append(squared_error(fix, LAT_DEG, LON_DEG))
    assert np.mean(exact) > 8
    assert 0.9 < np.mean(told) < 3.6


def refracted(field, camera, part):
    """Positions as they are in air that refracts more by a part of the standard air's refraction."""
    rays, up = camera.to_rays(field.uv), field.R_cam[:, 2]
    height = rays @ up
    outward = up - height[:, None] * rays
    length = np.linalg.norm(outward, axis=1)
    lift = part * refraction_rad(np.minimum(np.arctan2(length, height), np.pi / 2), 1010.0, 10.0)
    return camera.project(rays + outward / length[:, None] * lift[:, None])


@pytest.mark.parametrize("part", [0.25, -0.25])
def test_the_stars_show_a_refraction_that_is_far_off(part):
    """A quarter of it, as sea level's air at 2,350 m has: found within its sigma, and the position with it.

    Without that the mean squared error is 4 and the median error 0.7 km; the sum over 12 fields exceeds 52 by chance once in
    a thousand.
    """
    condition = Condition("tilted", v_max=6.0, noise_px=0.1, tilt_deg=45)
    camera, squares, errors = camera_of(condition), [], []
    for number in range(12):
        field = make_field(condition, 8, number)
        uv = refracted(field, camera, part)
        good = np.isfinite(uv).all(axis=1) & in_frame(uv)
        up = celnav.Attitude.up(field.R_cam[:, 2])
        fix = celnav.solve(uv[good], camera, field.utc, up, flux=field.flux[good])
        squares.append(squared_error(fix, field.lat_deg, field.lon_deg))
        errors.append(np.hypot(*east_north_km(field.lat_deg, field.lon_deg, fix.lat_deg, fix.lon_deg)))
        # Near the horizon refraction goes not quite as the pressure: a few hundredths.
        assert fix.details["refraction"] == pytest.approx(part, abs=4 * fix.details["refraction_sigma"] + 0.03)
    assert sum(squares) < 52
    assert np.median(errors) < 0.15


def test_refraction_is_left_as_told_where_it_holds():
    """No frame of noise alone shows another one: four standard deviations chance once in 16,000."""
    for number in range(12):
        field = make_field(WIDE, 8, number)
        fix = celnav.solve(field.uv, camera_of(WIDE), field.utc, celnav.Attitude.up(field.R_cam[:, 2]), flux=field.flux)
        assert "refraction" not in fix.details


def test_an_attitude_that_the_heading_contradicts_is_doubted():
    """Attitudes off by 0.1 deg about each axis, said to be exact: nobody can know the tilt, but the heading shows its like.

    One draw of the heading estimates the standard deviation of three: squared errors have no mean, and a median of 1 to 6.
    """
    squares = []
    for number in range(40):
        field = make_field(Condition("contradicted", noise_px=0.2, exact_attitude=True), 31, number)
        turned = rotation_of(np.radians(np.random.default_rng([7, number]).normal(0, 0.1, 3))) @ field.R_cam
        fix = celnav.solve(field.uv, camera_of(WIDE), field.utc, celnav.Attitude.exact(turned), flux=field.flux)
        squares.append(squared_error(fix, field.lat_deg, field.lon_deg))
    assert 0.5 < np.median(squares) < 6


@pytest.mark.parametrize("lat_deg", [0.0, 50.0, -80.0])
def test_a_contradicted_heading_says_as_much_at_any_latitude(lat_deg):
    """The mean of 2,000 covariances is that of the positions, within five standard errors (2 in 3 million by chance).

    One draw, squared, estimates the variance of an attitude that is off by 0.2 deg about each axis; its mean is the
    variance, with a standard error of sqrt(2 / 2,000).
    """
    rng = np.random.default_rng(11)
    true = enu_rotation(lat_deg, 20.0)
    told = celnav.Attitude.with_sigma(np.eye(3), tilt_deg=0.001, heading_deg=0.001)
    covariances, offsets = [], []
    for turn in np.radians(rng.normal(0, 0.2, (2000, 3))):
        place = honest_place(rotation_of(turn) @ true, np.eye(3) * 1e-12, told)
        covariances.append(place.cov_km2)
        offsets.append(east_north_km(lat_deg, 20.0, place.lat_deg, place.lon_deg))
    stated, real = np.mean(covariances, axis=0), np.cov(np.transpose(offsets))
    ratio = np.diag(stated) / np.diag(real)
    assert ratio == pytest.approx([1, 1], abs=5 * math.sqrt(4 / 2000))
