"""Each sensor effect's moments, its independence from the others, colour filters, and what is refused."""

import numpy as np
import pytest
import yaml
from scipy import stats
from small_scenes import BASE, small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.scenario.file import Scenario, parse_scenario
from generator.scenario.sensor_spec import SensorSpec
from generator.seeds import random_stream
from generator.sensor.charge import CosmicRays, FullWell, PhotonNoise, PhotoResponse
from generator.sensor.colour import filter_array
from generator.sensor.dark import DarkCurrent, HotPixels
from generator.sensor.detector import expose, streak_area_px
from generator.sensor.effect import Exposure
from generator.sensor.readout import FixedOffset, LineNoise, ReadNoise, TelegraphNoise

SHAPE = (300, 320)
EVERYTHING = {
    "prnu": 0.01, "dead_pixel_fraction": 1e-3, "dark_current_e_s": 4.0, "hot_pixel_fraction": 1e-3,
    "cosmic_rays": {"rate_s": 20.0}, "dsnu_e": 2.0, "read_noise_e": 3.0, "telegraph": {"fraction": 0.02, "amplitude_e": 20.0},
    "row_noise_e": 1.0, "column_noise_e": 1.0, "gain_e_per_dn": 0.1, "bits": 16, "full_well_e": 6000.0,
    "black_level_dn": 2000,
}  # fmt: skip


def exposure(number: int = 0) -> Exposure:
    return Exposure(2.0, lambda name: random_stream(5, name, number), lambda name: random_stream(5, f"unit.{name}", 0))


def read_out(**values) -> np.ndarray:
    now = exposure()
    spec = SensorSpec(**(EVERYTHING | values))
    return expose(np.full(SHAPE, 300.0, np.float32), 2.0, spec, now.frame, now.unit).astype(int)


@pytest.mark.parametrize("off", [
    {"read_noise_e": 0.0}, {"dsnu_e": 0.0}, {"telegraph": None}, {"row_noise_e": 0.0}, {"column_noise_e": 0.0},
    {"cosmic_rays": None}, {"dark_current_e_s": 0.0, "hot_pixel_fraction": 0.0},
])  # fmt: skip
def test_switching_one_effect_off_leaves_the_others_draws(off) -> None:
    """The difference of the two frames is that effect alone: what it adds by itself, to the quantiser's rounding."""
    difference = (read_out() - read_out(**off)) * 0.1
    now = exposure()
    alone = {
        "read_noise_e": ReadNoise(3.0), "dsnu_e": FixedOffset(2.0), "telegraph": TelegraphNoise(0.02, 20.0),
        "row_noise_e": LineNoise(1.0, 0.0), "column_noise_e": LineNoise(0.0, 1.0),
        "cosmic_rays": CosmicRays(20.0, 200.0, 4.0),
        "dark_current_e_s": DarkCurrent(4.0, (HotPixels(1e-3, 100.0, 1.4),), True),
    }[next(iter(off))].apply(np.zeros(SHAPE), now)  # fmt: skip
    assert alone.std() > 0
    np.testing.assert_allclose(difference, alone, atol=0.1001)


def test_fixed_patterns_stay_and_noise_does_not() -> None:
    flat = np.full(SHAPE, 1000.0)
    for fixed in (PhotoResponse(0.01, 1e-3), FixedOffset(2.0)):
        np.testing.assert_array_equal(fixed.apply(flat, exposure(0)), fixed.apply(flat, exposure(1)))
    for changing in (PhotonNoise(True), ReadNoise(1.0), LineNoise(1.0, 1.0), TelegraphNoise(0.5, 5.0)):
        assert (changing.apply(flat, exposure(0)) != changing.apply(flat, exposure(1))).mean() > 0.2


def test_dark_current_doubles() -> None:
    """6 deg C warmer, twice the mean: within 4 standard errors."""
    means = []
    for temperature in (20.0, 26.0, 8.0):
        spec = SensorSpec(
            dark_current_e_s=50.0, temperature_c=temperature, read_noise_e=0.0, gain_e_per_dn=0.25, bits=16
        )
        now = exposure()
        dn = expose(np.zeros(SHAPE, np.float32), 2.0, spec, now.frame, now.unit)
        means.append((dn.astype(float).mean() - 64) * 0.25)
    np.testing.assert_allclose(means, [100.0, 200.0, 25.0], atol=4 * np.sqrt(200 / np.prod(SHAPE)))


def test_hot_and_dead_pixels_have_their_share_and_size() -> None:
    dark = DarkCurrent(0.0, (HotPixels(0.01, 500.0, 0.5),), True).apply(np.zeros(SHAPE), exposure())
    count = int((dark > 0).sum())
    assert abs(count - 0.01 * dark.size) < 4 * np.sqrt(0.01 * dark.size)
    # The log-normal's standard deviation is sqrt(exp(0.25) - 1) = 0.53 of its mean.
    assert dark[dark > 0].mean() == pytest.approx(1000.0, rel=4 * 0.54 / np.sqrt(count))
    dead = PhotoResponse(0.0, 0.01).apply(np.full(SHAPE, 9.0), exposure()) == 0
    assert abs(dead.sum() - 0.01 * dead.size) < 4 * np.sqrt(0.01 * dead.size)


def test_telegraph_noise_has_three_peaks_and_a_tail() -> None:
    """Variance fraction x E[a^2] / 2, a exponential; a far heavier tail than the normal of that variance."""
    jumps = TelegraphNoise(0.05, 30.0).apply(np.zeros((1000, 1000)), exposure())
    wanted = 0.05 * 2 * 30.0**2 / 2
    assert jumps.var() == pytest.approx(wanted, rel=0.05)
    assert abs(jumps.mean()) < 4 * np.sqrt(wanted / jumps.size)
    assert stats.kurtosis(jumps, axis=None) > 20
    assert (jumps == 0).mean() == pytest.approx(1 - 0.05 / 2, abs=1e-3)


def test_line_noise_is_shared_by_lines() -> None:
    noise = LineNoise(2.0, 3.0).apply(np.zeros((2000, 2100)), exposure())
    assert noise.mean(axis=1).std() == pytest.approx(2.0, rel=4 / np.sqrt(2 * 2000))
    assert noise.mean(axis=0).std() == pytest.approx(3.0, rel=4 / np.sqrt(2 * 2100))
    residual = noise - noise.mean(axis=1, keepdims=True) - noise.mean(axis=0) + noise.mean()
    assert np.abs(residual).max() < 1e-9


def test_blooming_moves_charge_along_the_column_and_loses_none() -> None:
    signal = np.zeros((101, 5))
    signal[50, 2] = 10500.0
    spilled = FullWell(1000.0, True).apply(signal, exposure())
    assert spilled.sum() == pytest.approx(10500.0)
    assert spilled.max() == 1000.0
    assert np.delete(spilled, 2, axis=1).max() == 0
    assert np.flatnonzero(spilled[:, 2]).tolist() == list(range(45, 56))
    assert FullWell(1000.0, False).apply(signal, exposure()).sum() == 1000.0


def test_the_tracks_told_of_cosmic_rays_are_those_in_the_image() -> None:
    """Each pixel of charge lies within a pixel of a track, and the charge of tracks wholly inside is all there."""
    rays = CosmicRays(30.0, 200.0, 5.0)
    tracks = rays.tracks(SHAPE[1], SHAPE[0], exposure(3))
    image = rays.apply(np.zeros(SHAPE), exposure(3))
    assert len(tracks.length_px) > 10
    reached = np.zeros(SHAPE, bool)
    for start, end in zip(tracks.start_px, tracks.end_px, strict=True):
        for u, v in start + np.linspace(0, 1, 400)[:, None] * (end - start):
            if -0.5 <= u < SHAPE[1] - 0.5 and -0.5 <= v < SHAPE[0] - 0.5:
                reached[int(np.rint(v)), int(np.rint(u))] = True
    assert not (image > 0)[~reached].any()
    ends = np.stack([tracks.start_px, tracks.end_px])
    inside = ((ends >= -0.5) & (ends <= np.array(SHAPE[::-1]) - 0.5)).all(axis=(0, 2))
    assert tracks.electrons_e[inside].sum() <= image.sum() <= tracks.electrons_e.sum()


def test_noise_area_of_a_streak_by_sums_over_pixels() -> None:
    """1 / sum p^2 of a blurred segment, sampled finely; a point's is 4 pi sigma^2."""
    v, u = np.mgrid[-20:21:0.25, -20:41:0.25]
    for length, psf in ((0.0, 1.2), (7.0, 1.2), (20.0, 2.0)):
        variance = psf**2 + 1 / 12
        along = (np.arange(200) + 0.5)[:, None, None] / 200 * length
        profile = np.exp(-((u - along) ** 2 + v**2) / (2 * variance)).mean(axis=0) / (2 * np.pi * variance)
        assert streak_area_px(np.array([length]), psf)[0] == pytest.approx(16 / (profile**2).sum(), rel=2e-3)


def test_cosmic_rays_come_at_their_rate_with_their_charge() -> None:
    totals = [CosmicRays(30.0, 200.0, 5.0).apply(np.zeros(SHAPE), exposure(n)).sum() for n in range(60)]
    # 60 tracks per frame, each of mean charge 200 per px of track; a track below one pixel long counts as one.
    mean_length = 5.0 + 5.0 * 0 + (1 - 5.0 * (1 - np.exp(-1 / 5.0)))
    edge_loss = 5.0 * (2 / np.pi) * (SHAPE[0] + SHAPE[1]) / (SHAPE[0] * SHAPE[1])
    assert np.mean(totals) == pytest.approx(60 * 200 * mean_length * (1 - edge_loss), rel=0.1)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_filter_array_is_the_named_one(pattern) -> None:
    array = filter_array(pattern, 5, 7)
    letters = "".join("BGR"[array[row, column]] for row in (0, 1) for column in (0, 1))
    assert letters == pattern
    assert array.shape == (5, 7)
    assert (array[2:, :] == array[:-2, :]).all()


def test_bayer_mosaic_is_made_of_its_planes() -> None:
    """Each plane is what a monochrome sensor with that filter's curve sees, and the mosaic takes each pixel from its own."""
    from generator.plugins.stamp_light import FAINTEST_PIXEL_E

    colour = {"pattern": "GRBG"}
    plan = plan_frame(small_scenario(sensor={"colour": colour}, stars={"limiting_magnitude": 4.0}), 0)
    frame = render_expected(plan)
    alone = render_expected(plan, channels=False)
    assert not alone.channels
    np.testing.assert_array_equal(alone.electrons, frame.electrons)
    np.testing.assert_array_equal(alone.sky_electrons, frame.sky_electrons)
    assert list(frame.channels) == ["blue", "green", "red"]
    for name in frame.channels:
        mono = render_expected(plan_frame(
            small_scenario(sensor={"quantum_efficiency": f"cmos-{name}"}, stars={"limiting_magnitude": 4.0}), 0
        ))  # fmt: skip
        # A stamp's size follows the star's brightest channel, so its faintest pixels may differ.
        np.testing.assert_allclose(frame.channels[name], mono.electrons, rtol=2e-5, atol=FAINTEST_PIXEL_E)
    np.testing.assert_array_equal(frame.electrons[0::2, 0::2], frame.channels["green"][0::2, 0::2])
    np.testing.assert_array_equal(frame.electrons[0::2, 1::2], frame.channels["red"][0::2, 1::2])
    np.testing.assert_array_equal(frame.electrons[1::2, 0::2], frame.channels["blue"][1::2, 0::2])
    np.testing.assert_array_equal(frame.electrons[1::2, 1::2], frame.channels["green"][1::2, 1::2])


REFUSED = {
    "efficiency above 1": (
        {"quantum_efficiency": [[400, 0.5], [600, 1.2]]},
        ["sensor.quantum_efficiency.1.1", "1.2", "<= 1"],
    ),
    "negative": ({"colour": {"red": [[400, -0.1], [600, 0.2]]}}, ["sensor.colour.red.0.1", "-0.1", ">= 0"]),
    "pattern": ({"colour": {"pattern": "RGBG"}}, ["sensor.colour.pattern", "RGBG", "RGGB"]),
    "bits": ({"bits": 7}, ["sensor.bits", "7", ">= 8"]),
    "unit": ({"rolling_shutter": {"line_time_s": 1e-5}}, ["sensor.rolling_shutter.line_time_s", "line_time_us"]),
}


def scenario_with_curve(folder, text: str) -> Scenario:
    (folder / "qe.csv").write_text(text)
    return parse_scenario(
        yaml.safe_dump(BASE | {"sensor": {"quantum_efficiency": "qe.csv"}}), str(folder / "scene.yaml")
    )


def test_an_efficiency_curve_may_come_from_a_file(tmp_path) -> None:
    scenario = scenario_with_curve(tmp_path, "wavelength_nm,quantum_efficiency\n400,0.5\n600,0.8\n")
    assert scenario.frame(0).sensor.quantum_efficiency == ((400.0, 0.5), (600.0, 0.8))
    assert [file.path for file in scenario.files] == ["qe.csv"]
    for text, fragment in {
        "nm,qe\n400,0.5\n": "expected wavelength_nm, quantum_efficiency",
        "wavelength_nm,quantum_efficiency\n400,x\n600,1\n": "line 2, column quantum_efficiency: found 'x', expected a finite",
        "wavelength_nm,quantum_efficiency\n400,0.5\n600,1.5\n": "<= 1",
        "wavelength_nm,quantum_efficiency\n600,0.5\n400,0.5\n": "wavelengths must increase",
        "wavelength_nm,quantum_efficiency\n600,0.5\n": "found 1 rows of numbers, expected 2 to",
    }.items():
        with pytest.raises(ScenarioError, match=fragment) as caught:
            scenario_with_curve(tmp_path, text)
        assert "sensor.quantum_efficiency" in str(caught.value)


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_bad_sensors_are_refused(case) -> None:
    values, fragments = REFUSED[case]
    with pytest.raises(ScenarioError) as caught:
        small_scenario(sensor=values)
    for fragment in fragments:
        assert fragment in str(caught.value)
