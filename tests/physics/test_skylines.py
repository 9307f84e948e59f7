"""Skylines from random numbers: seeds, what they cover, and lamps."""

import numpy as np
import pytest

from generator.ground.skylines.buildings import lamp_intensity_cd
from generator.ground.skylines.canvas import Canvas, covered, strip
from generator.ground.skylines.draw import SKYLINES, skyline_panorama
from generator.ground.skylines.hills import ridge


def test_thin_strips_cover_their_width() -> None:
    """Summed over cells, a strip covers its own width, wherever it lies and however thin it is."""
    cells = np.arange(-20, 21) * 0.1
    for middle in (0.0, 0.033, 0.05):
        for width in (0.004, 0.1, 0.73):
            assert strip(cells, middle, width, 0.1).sum() * 0.1 == pytest.approx(width)
    assert covered(np.array([0.02]), np.array([0.0]), 0.1)[0] == pytest.approx(0.7)


@pytest.mark.parametrize(
    "name",
    # Trees and a street's houses are drawn one by one: some ten seconds each.
    [pytest.param(name, marks=[pytest.mark.journey] * (name not in ("hills", "masts"))) for name in sorted(SKYLINES)],
)
def test_a_skyline_follows_from_its_seed_and_covers_the_ground(name) -> None:
    first, again, other = (skyline_panorama([name], np.random.default_rng(seed), 10.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.alpha, again.alpha)
    np.testing.assert_array_equal(first.colour, again.colour)
    assert first.lamps == again.lamps
    assert first.shape != other.shape or (first.alpha != other.alpha).any()
    rows, columns = first.shape
    horizon = int(np.ceil(first.top_deg / (first.top_deg - first.bottom_deg) * rows))
    assert (first.alpha[horizon + 1 :] == 255).all()
    above = first.alpha[:horizon] / 255
    share = above.mean(axis=0).sum() / columns
    assert 0.0005 < share < 0.95
    # Detail finer than a texel: some of them are covered in part.
    assert ((above > 0.05) & (above < 0.95)).mean() > 1e-4
    assert first.distance_m is not None
    assert first.distance_m.min() > 1
    # No seam at north.
    step = np.abs(np.diff(first.alpha[:horizon].astype(int), axis=1, append=first.alpha[:horizon, :1])).mean(axis=0)
    assert step[-1] <= np.quantile(step, 0.999) + 1


@pytest.mark.journey
def test_a_street_has_lamps_at_their_poles_and_lit_windows() -> None:
    street = skyline_panorama(["street"], np.random.default_rng(5), 10.0)
    assert len(street.lamps) == 18
    heights = [lamp.place_m[2] + 1.6 for lamp in street.lamps]
    assert heights == pytest.approx([8.0] * 18)
    assert street.glow is not None
    glass = street.glow.max(axis=2) > 30
    assert 0.001 < glass.mean() < 0.2


def test_a_street_lamp_keeps_to_its_class() -> None:
    """EN 13201-2, G*5: at most 350 cd/klm at 70 deg from the nadir, 100 at 80, 10 at 90, none above; 6 klm."""
    assert [lamp_intensity_cd(gamma) for gamma in (70, 80, 90, 91)] == pytest.approx([2100, 600, 60, 0])


def test_a_ridge_has_the_slope_of_its_spectrum() -> None:
    """Mean power of 40 ridges over a decade of frequencies: slope -2.4 within 0.15 (three times its standard error)."""
    power = np.mean([np.abs(np.fft.rfft(ridge(np.random.default_rng(seed)))) ** 2 for seed in range(40)], axis=0)
    frequency = np.arange(len(power))
    used = slice(10, 300)
    slope = np.polyfit(np.log(frequency[used]), np.log(power[used]), 1)[0]
    assert slope == pytest.approx(-2.4, abs=0.15)


def test_nearer_things_are_drawn_over_farther_ones() -> None:
    canvas = Canvas(np.random.default_rng(0))
    patch = canvas.patch(90.0, 3.0, 0.0, 10.0)
    canvas.draw(patch, np.ones(patch.shape), np.array([1.0, 0, 0]), 100.0)
    canvas.draw(patch, np.full(patch.shape, 0.25), np.array([0, 1.0, 0]), 10.0)
    row, column = patch.rows.start + 5, patch.columns[5]
    np.testing.assert_allclose(canvas.colour[row, column], [0.75, 0.25, 0], atol=1e-6)
    assert canvas.distance[row, column] == 100
