"""Random streams: independent between names, frames and neighbouring seeds; repeatable. False-alarm rate 1e-4 each."""

import itertools

import numpy as np
from scipy import stats

from generator.seeds import random_stream, stream_key


def test_a_stream_can_be_made_again_alone() -> None:
    first = random_stream(0, "shot", 17).integers(0, 2**63, 8)
    assert (random_stream(0, "shot", 17).integers(0, 2**63, 8) == first).all()


def test_neighbouring_seeds_names_and_frames_are_unrelated() -> None:
    draws = {
        key: random_stream(*key).normal(size=20_000)
        for key in [(0, "shot", 0), (1, "shot", 0), (2, "shot", 0), (0, "shot", 1), (0, "read", 0), (0, "read", 1)]
    }
    pairs = list(itertools.combinations(draws.values(), 2))
    limit = stats.norm.isf(0.5e-4 / len(pairs))
    for one, other in pairs:
        assert abs(np.corrcoef(one, other)[0, 1]) * np.sqrt(20_000) < limit


def test_stream_keys_are_fixed() -> None:
    """CRC-32 of the name (ITU-T V.42): the check value of "123456789" is 0xCBF43926."""
    assert stream_key("123456789") == 0xCBF43926
