"""How deep stars are looked for in an identified field, and how deep the frame is said to be."""

import numpy as np
import pytest

from celnav.field_stars import _depth

MAGS = np.linspace(1.0, 6.0, 800)


def test_a_clear_frame_ends_where_its_stars_end():
    rng = np.random.default_rng(1)
    seen = (rng.random(800) < 0.9) & (MAGS < 5.0)
    n, limit = _depth(seen, MAGS, chance=0.002)
    assert limit == pytest.approx(5.0, abs=0.05)
    assert MAGS[n - 1] == pytest.approx(5.0, abs=0.3)


def test_gaps_in_cloud_show_stars_that_are_fainter_than_those_it_hides():
    """One star in seven is seen at any magnitude to V 5.5, but for a luckier few bright ones: as in photograph 003."""
    rng = np.random.default_rng(2)
    seen = (rng.random(800) < np.where(MAGS < 1.6, 0.45, 0.14)) & (MAGS < 5.5)
    n, limit = _depth(seen, MAGS, chance=0.001)
    assert limit < 3.0
    assert MAGS[n - 1] == pytest.approx(5.5, abs=0.4)


def test_faint_stars_that_clutter_meets_by_chance_are_left_out():
    rng = np.random.default_rng(3)
    seen = rng.random(800) < np.where(MAGS < 3.5, 0.9, 0.1)
    n, limit = _depth(seen, MAGS, chance=0.1)
    assert limit == pytest.approx(3.5, abs=0.1)
    assert MAGS[n - 1] == limit
