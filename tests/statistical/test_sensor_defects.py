"""Hot and blinking pixels, fixed lines and periodic interference: laws, temperature, time, truth."""

import numpy as np
import pytest
from scipy import stats
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.object_table import HOT_PIXEL_OBJECT, object_table
from generator.frame.render import render_frame
from generator.scenario.sensor_spec import SensorSpec
from generator.seeds import random_stream
from generator.sensor.charge import FullWell
from generator.sensor.dark import BlinkingPixels, HotPixels, telegraph_level
from generator.sensor.detector import expose
from generator.sensor.draws import uniform_at
from generator.sensor.effect import Exposure
from generator.sensor.readout import FixedLines, Interference
from generator.sensor.sparse import rare_pixels

SHAPE = (400, 500)
KEY = 4711


def exposure(number: int = 0, start_s: float = 0.0, exposure_s: float = 1.0) -> Exposure:
    return Exposure(
        exposure_s,
        lambda name: random_stream(5, name, number),
        lambda name: random_stream(5, f"unit.{name}", 0),
        start_s,
    )


@pytest.mark.parametrize("fraction", [1e-4, 0.013, 0.5, 1.0])
def test_rare_pixels_are_independent_draws(fraction) -> None:
    """Counts are binomial and places uniform, each at a false alarm of 1e-4; neighbours as often as chance has it."""
    size, rounds = 20_000, 200
    random = np.random.default_rng(8)
    drawn = [rare_pixels(random, size, fraction) for _ in range(rounds)]
    assert all((np.diff(places) > 0).all() and places[0] >= 0 and places[-1] < size for places in drawn if len(places))
    counts = np.array([len(places) for places in drawn])
    wanted = size * fraction * rounds
    assert abs(counts.sum() - wanted) <= 3.9 * np.sqrt(wanted * (1 - fraction))
    spread = ((counts - size * fraction) ** 2).sum() / max(size * fraction * (1 - fraction), 1e-9)
    if fraction < 1:
        assert stats.chi2(rounds).sf(spread) > 5e-5
        assert stats.chi2(rounds).cdf(spread) > 5e-5
        whole = np.concatenate(drawn) / size
        assert stats.kstest(whole + random.random(len(whole)) / size, "uniform").pvalue > 1e-4
    pairs = sum(int((np.diff(places) == 1).sum()) for places in drawn)
    expected = rounds * (size - 1) * fraction**2
    assert abs(pairs - expected) <= 3.9 * np.sqrt(3 * expected * (1 - fraction) + 1)


def test_no_pixels_are_rare_where_there_are_none() -> None:
    assert len(rare_pixels(np.random.default_rng(1), 1000, 0.0)) == 0


@pytest.mark.parametrize("fraction", [1e-19, 1e-300])
def test_gaps_beyond_64_bits_lead_beyond_the_sensor(fraction) -> None:
    assert [len(rare_pixels(np.random.default_rng(seed), 10**8, fraction)) for seed in range(20)] == [0] * 20


def test_levels_at_many_times_are_those_one_by_one() -> None:
    time = np.random.default_rng(2).uniform(-50, 50, (7, 300))
    np.testing.assert_array_equal(telegraph_level(KEY, time), [telegraph_level(KEY, each) for each in time])


def test_charge_that_runs_over_stays_in_its_column() -> None:
    """Columns on their own, one by one, and a frame without saturation; charge is kept where it does not reach the ends."""
    charge = np.random.default_rng(3).uniform(0, 100, (60, 40)).astype(np.float32)
    charge[30, 7], charge[28:33, 20] = 900.0, 400.0
    well = FullWell(100.0, blooming=True)
    whole = well.apply(charge, exposure())
    for column in range(40):
        np.testing.assert_array_equal(
            whole[:, column : column + 1], well.apply(charge[:, column : column + 1], exposure())
        )
    assert whole.max() <= 100
    assert whole.sum() == pytest.approx(charge.sum(), rel=1e-5)
    dark = charge[:10]
    np.testing.assert_array_equal(well.apply(dark, exposure()), dark)


def test_hot_pixels_are_log_normal() -> None:
    """Kolmogorov and Smirnov's test at a false alarm of 1e-4, of mean and width as given."""
    _, excess = HotPixels(0.05, 100.0, 1.4).excess_e_s(SHAPE, exposure())
    wanted = stats.norm(np.log(100.0) - 1.4**2 / 2, 1.4)
    assert stats.kstest(np.log(excess), wanted.cdf).pvalue > 1e-4


def test_the_tail_of_hot_pixels_is_that_of_a_photograph() -> None:
    """Counts above levels in the dark corners of four frames of an all-sky camera (preset superstar-allsky, 60 s, 0.27 e/DN).

    Its 532,236 pixels held 35, 29, 8 and 6 above 2, 5, 20 and 40 thousand DN, medians of the four frames. Fraction and mean
    are fitted, the width is the default: each count within Poisson limits of a false alarm of 1e-3 in all.
    """
    seen = {2e3: 35, 5e3: 29, 2e4: 8, 4e4: 6}
    pixels, fraction, mean_dn = 532236, 8.5e-5, 85 * 60 / 0.27
    law = stats.norm(np.log(mean_dn) - 1.4**2 / 2, 1.4)
    for level, count in seen.items():
        expected = pixels * fraction * law.sf(np.log(level))
        assert stats.poisson(expected).cdf(count) > 1e-3 / 8
        assert stats.poisson(expected).sf(count - 1) > 1e-3 / 8


def test_hot_pixels_double_more_slowly_than_the_mean_dark_current() -> None:
    """Generation in the depletion region goes as exp(-Eg / 2kT) T^1.5, diffusion as its square (Widenhorn et al. 2002)."""
    boltzmann_ev, gap_ev, kelvin = 8.617e-5, 1.12, 293.15
    rate = 1.5 / kelvin + gap_ev / (2 * boltzmann_ev * kelvin**2)
    assert np.log(2) / rate == pytest.approx(8.5, abs=0.2)
    warm = SensorSpec(temperature_c=28.5, dark_doubling_c=6.0)
    assert warm.hot_factor == pytest.approx(2.0)
    assert warm.dark_factor == pytest.approx(2 ** (8.5 / 6))


def test_numbers_by_address_are_uniform_and_always_the_same() -> None:
    first, second = np.arange(20000) % 200, np.arange(20000) // 200 - 50
    numbers = uniform_at(KEY, first, second, 5)
    assert numbers.shape == (5, 20000)
    assert stats.kstest(numbers.ravel(), "uniform").pvalue > 1e-4
    np.testing.assert_array_equal(uniform_at(KEY, first[::-7], second[::-7], 5), numbers[:, ::-7])
    assert len(np.unique(numbers)) > 0.999 * numbers.size


def test_a_random_telegraph_process_has_its_correlation_and_dwell_times() -> None:
    """Correlation exp(-t) within 4.5 standard errors at each of six lags, dwell times exponential with mean 2."""
    count = 40000
    base = np.random.default_rng(1).uniform(-1e6, 1e6, count)
    before = 2.0 * telegraph_level(KEY, base) - 1
    assert abs(before.mean()) < 4.5 / np.sqrt(count)
    for lag in (0.1, 0.5, 1.0, 2.0, 4.0, 30.0):
        after = 2.0 * telegraph_level(KEY, base + lag) - 1
        assert (before * after).mean() == pytest.approx(np.exp(-lag), abs=4.5 / np.sqrt(count))
    step, length, pixels = 0.1, 40.0, 800
    levels = np.stack(
        [telegraph_level(KEY, np.full(pixels, 17.3) + time) for time in np.arange(0, length + step / 2, step)]
    )
    jumps = (levels[1:] != levels[:-1]).sum()
    # After a step the level was drawn anew with probability 1 - exp(-step), and half of the draws change it.
    wanted = pixels * length / step * (1 - np.exp(-step)) / 2
    assert jumps == pytest.approx(wanted, abs=4.5 * np.sqrt(wanted))


def test_blinking_pixels_are_the_same_process_in_all_frames() -> None:
    blinking = BlinkingPixels(0.01, 50.0, 10.0, 10.0)
    places, first = blinking.excess_e_s(SHAPE, exposure(0, start_s=8e8))
    same, again = blinking.excess_e_s(SHAPE, exposure(7, start_s=8e8))
    np.testing.assert_array_equal(places, same)
    np.testing.assert_array_equal(first, again)
    _, soon = blinking.excess_e_s(SHAPE, exposure(1, start_s=8e8 + 1))
    _, late = blinking.excess_e_s(SHAPE, exposure(2, start_s=8e8 + 1000))
    assert np.corrcoef(first, soon)[0, 1] > np.corrcoef(first, late)[0, 1] + 0.2
    # Half of the exponential's mean, whose spread with the level's is sqrt(3) of that, to 4.5 standard errors.
    assert first.mean() == pytest.approx(25.0, rel=4.5 * np.sqrt(3 / len(first)))


def test_fixed_lines_stay_and_are_shared_by_lines() -> None:
    pattern = FixedLines(2.0, 3.0).apply(np.zeros((2000, 2100), np.float32), exposure(0))
    np.testing.assert_array_equal(pattern, FixedLines(2.0, 3.0).apply(np.zeros((2000, 2100), np.float32), exposure(1)))
    assert pattern.mean(axis=1).std() == pytest.approx(2.0, rel=4 / np.sqrt(2 * 2000))
    assert pattern.mean(axis=0).std() == pytest.approx(3.0, rel=4 / np.sqrt(2 * 2100))


def test_interference_is_a_line_of_the_spectrum() -> None:
    """The peak stands at its frequency, and its power over the white noise's is N A^2 / (4 sigma^2) within 10 %."""
    height, width, amplitude, read = 256, 512, 1.0, 3.0
    spec = SensorSpec(
        interference=({"cycles_per_column": 37 / 512, "cycles_per_row": -20 / 256, "amplitude_e": amplitude},),
        read_noise_e=read, dark_current_e_s=0.0, gain_e_per_dn=0.2, bits=16, black_level_dn=500,
    )  # fmt: skip
    powers = np.zeros((height, width))
    for number in range(40):
        now = exposure(number)
        dn = expose(np.zeros((height, width), np.float32), 1.0, spec, now.frame, now.unit).astype(float)
        powers += np.abs(np.fft.fft2((dn - dn.mean()) * 0.2)) ** 2 / 40
    row, column = np.unravel_index(np.argmax(powers), powers.shape)
    assert (int(row), int(column)) in {(256 - 20, 37), (20, 512 - 37)}
    white = np.median(powers)
    # The peak's own white noise adds one, and scatters by less than 0.5 % over 40 frames.
    assert powers[row, column] / white == pytest.approx(
        1 + height * width * amplitude**2 / (4 * (read**2 + 0.2**2 / 12)), rel=0.1
    )


def test_the_phase_of_interference_is_new_in_every_frame() -> None:
    wave = Interference(0.1, 0.05, 2.0, 0)
    flat = np.zeros(SHAPE, np.float32)
    assert np.abs(wave.apply(flat, exposure(0)) - wave.apply(flat, exposure(1))).max() > 0.1
    assert wave.apply(flat, exposure(0)).std() == pytest.approx(2 / np.sqrt(2), rel=1e-3)


def test_hot_and_blinking_pixels_have_rows_of_truth() -> None:
    """Each row's pixel is the brightest around and exceeds the neighbours' by what the row says, to 6 standard deviations."""
    sensor = {
        "hot_pixel_fraction": 2e-3, "hot_pixel_e_s": 2000.0, "blinking_pixels": {"fraction": 2e-3, "amplitude_e_s": 3000.0},
        "gain_e_per_dn": 0.5, "bits": 16,
    }  # fmt: skip
    frame = render_frame(small_scenario(sensor=sensor), 0)
    rows = object_table(frame.plan, frame.expected).to_pandas()
    rows = rows[rows["object"] == HOT_PIXEL_OBJECT]
    assert set(rows["kind"]) == {"hot_pixel", "blinking_pixel"}
    assert (rows["snr"] >= 5).all()
    image = (frame.dn.astype(float) - 64) * 0.5
    u, v = rows["centroid_u_px"].to_numpy(int), rows["centroid_v_px"].to_numpy(int)
    spec = frame.plan.spec
    clear = image[v, u] < 0.9 * spec.sensor.full_well_e
    light = frame.expected.electrons[v, u]
    added = image[v, u] - light - spec.sensor.mean_dark_e_s * spec.time.exposure_s - rows["electrons_e"].to_numpy()
    noise = np.sqrt(rows["electrons_e"].to_numpy() + light + 10)
    assert (np.abs(added / noise)[clear] < 6).all()
    assert clear.sum() > 10


REFUSED = {
    "constants": (
        {"blinking_pixels": {"fraction": 0.1, "amplitude_e_s": 1, "time_constant_s": [5, 1]}},
        "the shortest",
    ),
    "frequency": (
        {"interference": [{"cycles_per_column": 0.7, "cycles_per_row": 0, "amplitude_e": 1}]},
        "interference.0.cycles_per_column",
    ),
    "width": ({"hot_pixel_log_sigma": -1}, "sensor.hot_pixel_log_sigma"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_bad_values_are_refused(case) -> None:
    values, fragment = REFUSED[case]
    with pytest.raises(ScenarioError, match=fragment):
        small_scenario(sensor=values)
