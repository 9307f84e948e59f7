"""The speed of the full sky."""

import pytest

from generator.speed.pairs import time_skies


@pytest.mark.slow
def test_full_sky_costs_at_most_60_percent_more() -> None:
    """Median of paired runs, the Moon up, against airglow and city light alone."""
    assert time_skies(15).ratio < 1.6
