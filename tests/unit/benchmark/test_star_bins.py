"""Stars in bins, on pairs of images whose answer is known: SNR by magnitude, width by the angle from the axis."""

import dataclasses
import json
import math

import numpy as np
import pytest

from benchmark.photographed.star_light import star_light
from benchmark.photographed.star_width import star_widths
from benchmark.photographed.view import view_of
from benchmark.stats.intervals import Estimate
from benchmark.studies.realism.star_tables import Pair, pairs_of, star_figures, star_tables
from benchmark.twin.comparison import Measured, Stars, measure
from benchmark.twin.star_bins import (
    LEAST_STARS,
    StarBin,
    binned,
    bins_of,
    plain_bins,
    snr_by_magnitude,
    width_by_angle,
)
from celnav.camera import Camera

SIZE_PX, F_PX = 640, 180.0
CAMERA = Camera("equidistant", SIZE_PX, SIZE_PX, f_px=F_PX)
UP = np.eye(3)
SKY_DN, NOISE_DN = 1000.0, 8.0
BRIGHT_DN = 1.5e5
"""Light of a star of V 0."""


def star_field() -> Stars:
    """Stars on a grid with steps of 22 px within 85 deg of the axis, which points at the zenith; V 2 to 6."""
    rng = np.random.default_rng(31)
    grid = np.stack(np.meshgrid(np.arange(25, SIZE_PX - 25, 22.0), np.arange(25, SIZE_PX - 25, 22.0)), -1).reshape(
        -1, 2
    )
    uv = grid + rng.uniform(-0.5, 0.5, grid.shape)
    off_axis_deg = np.degrees(np.hypot(*(uv - (SIZE_PX - 1) / 2).T) / F_PX)
    near = off_axis_deg < 85
    uv, off_axis_deg = uv[near], off_axis_deg[near]
    return Stars(uv, rng.uniform(2, 6, len(uv)), 90 - off_axis_deg, off_axis_deg)


STARS = star_field()


def picture(seed: int, light: float = 1.0, sigma_px: np.ndarray | float = 0.9) -> np.ndarray:
    """A picture of the stars, Gaussians sampled at the pixels' centres, with white noise."""
    image = np.full((SIZE_PX, SIZE_PX), SKY_DN)
    sigmas = np.broadcast_to(sigma_px, len(STARS.uv))
    flux = light * BRIGHT_DN * 10 ** (-0.4 * STARS.v_mag)
    steps = np.arange(-10, 11)
    for (x, y), strength, sigma in zip(STARS.uv, flux, sigmas, strict=True):
        u, v = round(x) + steps, round(y) + steps
        r2 = (u - x) ** 2 + (v[:, None] - y) ** 2
        image[v[0] : v[-1] + 1, u[0] : u[-1] + 1] += strength * np.exp(-r2 / (2 * sigma**2)) / (2 * np.pi * sigma**2)
    return np.random.default_rng(seed).normal(image, NOISE_DN)


def measured(image: np.ndarray) -> Measured:
    view = view_of(CAMERA, UP)
    sky = np.nan_to_num(view.altitude_deg, nan=-90) > 5
    return measure(image, np.zeros(image.shape), view, sky, STARS, 65535.0)


def error(one: StarBin) -> float:
    """Standard deviation that the interval of a ratio states."""
    return (one.ratio.high - one.ratio.low) / (2 * 1.96)


def test_fainter_stars_have_their_ratio_at_every_magnitude() -> None:
    """Stars of the photograph have 0.8 of the light: each bin within four of its stated errors (of four bins 3e-4 fail)."""
    real, twin = measured(picture(1, light=0.8)), measured(picture(2))
    bins = snr_by_magnitude(real, twin)
    assert [(one.low, one.high) for one in bins] == [(2, 3), (3, 4), (4, 5), (5, 6)]
    assert sum(one.ratio.n for one in bins) > 300
    low = STARS.altitude_deg < 20
    assert low.sum() > 40
    assert np.isnan(real.snr[low]).all()
    assert np.isfinite(real.snr[~low]).all()
    for one in bins:
        assert one.low < one.middle < one.high
        assert one.ratio.value == pytest.approx(one.real.value / one.twin.value)
        assert one.ratio.low <= one.ratio.value <= one.ratio.high
        assert abs(one.ratio.value - 0.8) < 4 * max(error(one), 1e-3)
        assert error(one) < 0.05
    # Light does not change the width of stars.
    for one in width_by_angle(real, twin):
        assert abs(one.ratio.value - 1) < 4 * max(error(one), 1e-3)


def test_a_twin_blurred_at_the_edge_differs_there_and_nowhere_else() -> None:
    far = STARS.off_axis_deg >= 45
    real, twin = measured(picture(3)), measured(picture(4, sigma_px=np.where(far, 1.2, 0.9)))
    bins = width_by_angle(real, twin)
    assert [one.low for one in bins] == [0, 15, 30, 45, 60, 75]
    for one in bins:
        true = 0.9 / 1.2 if one.low >= 45 else 1.0
        assert abs(one.ratio.value - true) < 4 * max(error(one), 2e-3), one
        assert error(one) < 0.05
        assert one.real.value == pytest.approx(0.9, abs=0.04)
    # Blur moves light out of apertures of 3.5 px by less than 2 %.
    for one in snr_by_magnitude(real, twin):
        assert one.ratio.value == pytest.approx(1, abs=0.08)


def test_intervals_hold_the_true_ratio_as_often_as_they_say() -> None:
    """60 bins of 30 stars: fewer than 47 intervals hold the truth with a probability of 1e-6 at 95 % coverage, 2e-4 at 92 %.

    The mean of the 60 logarithms is within four of its standard errors, by their scatter: 1 in 16,000 fails.
    """
    rng, held, logs = np.random.default_rng(17), 0, []
    for _ in range(60):
        light = 10 ** rng.uniform(1, 1.4, 30)
        real, twin = 0.8 * light + rng.normal(0, 1.5, 30), light + rng.normal(0, 1.5, 30)
        (one,) = binned(np.full(30, 4.5), (4.0, 5.0), real, twin)
        held += one.ratio.low <= 0.8 <= one.ratio.high
        logs.append(math.log(one.ratio.value))
    assert held >= 47
    assert abs(np.mean(logs) - math.log(0.8)) < 4 * np.std(logs, ddof=1) / math.sqrt(len(logs))


@pytest.mark.parametrize("sigma_px", [0.6, 0.8, 1.2, 2.0])
def test_the_width_of_a_gaussian_star_is_found_wherever_its_centre_lies(sigma_px: float) -> None:
    """Sampled at the centres of pixels; the samples of a narrow star miss a part of its light, up to 4 % of its width."""
    rng = np.random.default_rng(5)
    uv = (
        30 + 40 * np.stack(np.meshgrid(np.arange(8), np.arange(8)), -1).reshape(-1, 2) + rng.uniform(-0.5, 0.5, (64, 2))
    )
    v, u = np.mgrid[0:350, 0:350]
    image = 500 + sum(3e3 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * sigma_px**2)) for x, y in uv)
    found = star_widths(image, star_light(image, uv, search_px=2.0))
    assert found == pytest.approx(np.full(64, sigma_px), rel=0.04)


def test_light_without_a_width_has_none() -> None:
    image = np.full((60, 60), 100.0)
    image[30, 30] = 90.0
    uv = np.array([[30.0, 30.0], [np.nan, 1.0], [2.0, 30.0]])
    assert np.isnan(star_widths(image, star_light(image, uv))).all()


def test_bins_of_too_few_stars_are_left_out_and_stars_that_one_image_lacks_count_nowhere() -> None:
    by = np.repeat([1.0, 3.0, 5.0], [LEAST_STARS - 1, LEAST_STARS, LEAST_STARS])
    real = np.ones(len(by))
    twin = np.ones(len(by))
    twin[-1] = np.nan
    (one,) = binned(by, (0.0, 2.0, 4.0, 6.0), real, twin)
    assert (one.low, one.high, one.ratio) == (2.0, 4.0, Estimate(1.0, 1.0, 1.0, LEAST_STARS))


def test_there_is_no_ratio_to_stars_that_the_twin_does_not_show() -> None:
    rng = np.random.default_rng(8)
    by, seen = np.full(20, 5.5), rng.normal(5, 1, 20)
    (hidden,) = binned(by, (5.0, 6.0), seen, rng.normal(0.5, 1, 20), 2.0)
    assert hidden.real.value == pytest.approx(5, abs=1.2)
    assert math.isnan(hidden.ratio.value)
    (lost,) = binned(by, (5.0, 6.0), rng.normal(0, 1, 20), seen, 2.0)
    assert abs(lost.ratio.value) < 0.3
    # A twin of which half of the stars are hidden may have any ratio.
    (half,) = binned(by, (5.0, 6.0), seen, np.where(np.arange(20) % 2, 5.0, -1.0), 1.9)
    assert half.ratio.high == math.inf
    stored = json.loads(json.dumps(plain_bins([hidden, lost, half]), allow_nan=False))
    again = bins_of(stored)
    assert again[2].ratio.high == math.inf
    assert math.isnan(again[0].ratio.value)
    assert again[1].ratio.value == pytest.approx(lost.ratio.value, abs=1e-4)


def one_bin(low: float, high: float, value: float) -> StarBin:
    estimate = Estimate(value, 0.9 * value, 1.1 * value, 20)
    return StarBin(low, high, (low + high) / 2, estimate, estimate, Estimate(1.0, 0.9, 1.1, 20))


def test_tables_and_figures_show_what_there_is() -> None:
    undefined = dataclasses.replace(one_bin(5.0, 6.0, 2.0), ratio=Estimate(math.nan, math.nan, math.nan, 9))
    pairs = (
        Pair("clear", (one_bin(-2.0, 2.0, 90.0), one_bin(4.0, 5.0, 9.0)), (one_bin(15.0, 30.0, 0.8),)),
        Pair("cloud", (undefined,), ()),
        Pair("blank", (), ()),
    )
    by_snr, by_angle = star_tables(pairs)
    assert by_snr.header == ("photograph", "V to 2", "V 4 to 5", "V 5 to 6")
    assert by_snr.rows[0] == ("clear", "1.00 (0.90 to 1.10), 20", "1.00 (0.90 to 1.10), 20", "-")
    assert by_snr.rows[1:] == (("cloud", "-", "-", "—, 9"), ("blank", "-", "-", "-"))
    assert by_angle.header == ("photograph", "deg 15 to 30")
    assert star_tables(pairs[2:]) == ()
    drawn = star_figures(pairs)
    assert [one.title for one in drawn] == ["SNR, clear", "Width of stars, clear", "SNR, cloud"]
    assert all("<svg" in one.html and "photograph" in one.html for one in drawn)
    assert star_figures(pairs_of([{"photograph": "x", "snr_by_magnitude": [], "width_by_angle": []}])) == ()
