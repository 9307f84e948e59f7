import numpy as np

from benchmark.frames.preview import stretch
from benchmark.report.formatting import interval, number, percent
from benchmark.stats.intervals import Estimate


def test_stretch_keeps_order_and_uses_the_range():
    ramp = np.random.default_rng(np.random.SeedSequence(4)).normal(200.0, 5.0, (100, 100))
    ramp[50, 50], ramp[20, 20] = 4000.0, 1000.0
    picture = stretch(ramp.astype(np.uint16))
    assert picture[50, 50] == 255
    assert picture[20, 20] > np.median(picture)
    assert 10 < np.median(picture) < 180
    assert stretch(np.full((5, 5), 7, dtype=np.uint16)).std() == 0


def test_numbers_are_printed_with_three_digits():
    assert [number(value) for value in (0.0, 0.01234, 1.234, 12.34, 12345.6)] == [
        "0",
        "0.0123",
        "1.23",
        "12.3",
        "12\u2009346",
    ]
    assert [number(value) for value in (999_999.0, 1_836_044_491.0, -2e6)] == [
        "999\N{THIN SPACE}999",
        "1.84e9",
        "-2.00e6",
    ]
    assert (number(float("inf")), number(float("nan")), percent(float("nan"))) == ("∞", "—", "—")
    assert [percent(value) for value in (0.0, 0.5556, 1.0)] == ["0 %", "55.6 %", "100 %"]
    assert interval(Estimate(0.5, 0.25, 0.75, 4), percent) == "25.0 – 75.0 %"
