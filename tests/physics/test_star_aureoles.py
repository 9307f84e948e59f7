"""Aureoles of stars behind cloud: how far light is diffracted, and how much of it arrives."""

import numpy as np
import pytest
from scipy.special import gammaincinv
from small_scenes import small_scenario

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.point_lights import aureoles, faint_lights, star_lights
from generator.light.cloud_kinds import WAVELENGTH_UM, point_share
from generator.light.cloud_phase import DIFFRACTION_DEPTHS, SIZE_VARIANCE, SIZES, aureole_radii

EVEN = {"altitude_km": 9.0, "mean_optical_depth": 1.2, "coverage": 1.0, "particle_um": 60.0}
DIAMETERS_UM = gammaincinv(1 / SIZE_VARIANCE, (np.arange(SIZES) + 0.5) / SIZES) * 60 * SIZE_VARIANCE


def part_within(angle: np.ndarray) -> np.ndarray:
    """Of light that is diffracted once, by the law of one disk."""
    return np.mean([2 * (1 - np.vectorize(point_share)(size, angle)) for size in DIAMETERS_UM], axis=0)


def test_thin_cloud_diffracts_as_disks_do() -> None:
    radii = aureole_radii(60.0, 40)[0, :36]
    assert part_within(radii) == pytest.approx((np.arange(36) + 0.5) / 40, abs=0.015)


@pytest.mark.parametrize("depth", [0.5, 1.5, 4.0])
def test_angles_of_several_diffractions_add_up(depth: float) -> None:
    """Against light that is turned by random angles, once for each particle on its way."""
    rng = np.random.default_rng(1)
    angle = np.linspace(0, 40 * WAVELENGTH_UM / 60, 4000)
    within = np.maximum.accumulate(part_within(angle))
    count = rng.poisson(depth, 40_000)
    place = np.zeros((len(count), 2))
    for turn in range(count.max()):
        on = count > turn
        by = np.interp(rng.random(on.sum()), within, angle)
        way = rng.uniform(0, 2 * np.pi, on.sum())
        place[on] += by[:, None] * np.column_stack((np.cos(way), np.sin(way)))
    walked = np.quantile(np.hypot(*place[count > 0].T), [0.25, 0.5, 0.75])
    table = aureole_radii(60.0, 200)
    row = [np.interp(depth, DIFFRACTION_DEPTHS, table[:, column]) for column in (50, 100, 150)]
    assert row == pytest.approx(walked, rel=0.04)


def test_image_and_aureole_are_what_is_not_scattered_otherwise() -> None:
    """exp(-t / 2) of the light without cloud arrives around the stars, exp(-t) in their images."""
    clear = plan_frame(small_scenario(sky={"components": []}), 0)
    plan = plan_frame(small_scenario(sky={"components": [], "clouds": EVEN | {"star_aureoles": True}}), 0)
    assert plan.cloud_transmission == pytest.approx(np.exp(-plan.cloud_optical_depth), rel=1e-6)
    stars = star_lights(plan)
    bright = np.flatnonzero(stars.v_mag < 4)
    around = aureoles(plan, stars[bright])
    light = (10 ** (-0.4 * around.v_mag)).sum()
    free = 10 ** (-0.4 * clear.stars.v_mag[bright])
    depth = plan.cloud_optical_depth[bright]
    assert light == pytest.approx((free * (np.exp(-depth / 2) - np.exp(-depth))).sum(), rel=1e-3)


def test_aureoles_are_drawn_only_where_a_scenario_asks() -> None:
    plain = plan_frame(small_scenario(sky={"components": [], "clouds": EVEN}), 0)
    assert faint_lights(plain) is None
    asked = plan_frame(small_scenario(sky={"components": [], "clouds": EVEN | {"star_aureoles": True}}), 0)
    assert len(faint_lights(asked) or ()) > 0
    expected = render_expected(asked, False, False)
    inside = np.nan_to_num(expected.star_electrons * expected.fraction_in_frame).sum()
    # exp(0.6) - 1 of the images' light, more where the line of sight is slant, less what stars too faint to draw have.
    assert 1.5 < expected.electrons.sum() / inside < 4


def test_nothing_is_seen_of_stars_behind_thick_cloud() -> None:
    thick = EVEN | {"mean_optical_depth": 40.0, "star_aureoles": True}
    plan = plan_frame(small_scenario(sky={"components": [], "clouds": thick}), 0)
    assert plan.cloud_optical_depth.max() > 100
    assert len(faint_lights(plan) or ()) == 0
