"""How alike pictures look: stars that were moved, patches that were painted, skies of another shape."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from benchmark.studies.realism.likeness import likenesses, patches, shift_of, similarity, structure_of

MIDDLE, CIRCLE_PX, DARK_DN = (159.5, 127.5), 120.0, 100.0
V, U = np.mgrid[0:256, 0:320]


def sky(gradient: float, seed: int, stars: int = 150, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """An even slope across the frame, stars at places of one seed, noise of another."""
    places = np.random.default_rng(1).uniform((45, 15), (275, 240), (stars, 2))
    light = 1000.0 * np.exp(gradient * (U - 160) / 160)
    for u, v in places + np.array(shift):
        light += 2000 * np.exp(-((U - u) ** 2 + (V - v) ** 2) / 2)
    return DARK_DN + light + np.random.default_rng(seed).normal(0, 20, light.shape)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.26), (-1.3, 0.7)])
def test_stars_that_were_moved_are_found_moved(shift) -> None:
    found = shift_of(sky(0.2, 2), sky(0.2, 3, shift=shift), MIDDLE, CIRCLE_PX)
    assert found == pytest.approx((-shift[0], -shift[1]), abs=0.05)


def test_painted_patches_are_counted_and_stars_are_not() -> None:
    plain = sky(0.2, 2) - DARK_DN
    assert patches(plain, MIDDLE, CIRCLE_PX) == (0, 0.0)
    # Two disks of radius 12 px inside the circle, one outside.
    for u, v in ((120, 100), (200, 150), (10, 10)):
        plain[np.hypot(U - u, V - v) < 12] *= 1.8
    count, share = patches(plain, MIDDLE, CIRCLE_PX)
    assert count == 2
    assert share == pytest.approx(2 * 12**2 / (0.9 * CIRCLE_PX) ** 2, rel=0.2)


def test_a_sky_is_more_like_its_own_twin_than_another() -> None:
    cloud = 1 + 0.5 * gaussian_filter(np.random.default_rng(5).normal(0, 20, V.shape), 20)
    real = [sky(1.0, 2), DARK_DN + (sky(0.0, 3) - DARK_DN) * np.clip(cloud, 0.3, 3)]
    twins = [sky(1.0, 4), DARK_DN + (sky(0.0, 5) - DARK_DN) * np.clip(cloud, 0.3, 3)]
    found = likenesses(real, twins, DARK_DN, MIDDLE, CIRCLE_PX)
    for one in found:
        assert one.structure > 0.95
        assert one.structure_of_others < one.structure - 0.1
        assert one.patches_real == one.patches_twin
    single = likenesses(real[:1], twins[:1], DARK_DN, MIDDLE, CIRCLE_PX)
    assert np.isnan(single[0].structure_of_others)


def test_brightness_alone_is_no_structure() -> None:
    one, other = (structure_of(factor * (sky(0.5, 2) - DARK_DN), MIDDLE, CIRCLE_PX) for factor in (1.0, 7.0))
    assert similarity(one, other, MIDDLE, CIRCLE_PX) == pytest.approx(1.0, abs=1e-9)
