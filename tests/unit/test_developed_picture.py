"""The 8-bit picture and the head-up display."""

import numpy as np
import pytest
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from small_scenes import small_scenario

from generator.colour_science import srgb_encoded
from generator.errors import ScenarioError
from generator.frame.render import render_dataset, render_frame
from generator.scenario.sensor_spec import SensorSpec
from generator.sensor.colour import filter_array
from generator.sensor.develop import demosaic, develop
from generator.sensor.hud import hud_mask


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_demosaicing_is_exact_for_ramps_and_flat_colours(pattern) -> None:
    """Bilinear interpolation reproduces what is linear up to the last pixel but one, and what is flat up to the border.

    A pixel keeps what it measured, whatever lies around it.
    """
    v, u = np.mgrid[0:20, 0:24].astype(float)
    planes = np.stack([0.2 + 0.01 * u, 0.3 + 0.005 * v, np.full(u.shape, 0.1)], axis=-1)
    channel_of = 2 - filter_array(pattern, 20, 24)[:, :, None]
    picture = demosaic(np.take_along_axis(planes, channel_of, axis=2)[:, :, 0], pattern)
    assert picture.shape == planes.shape
    np.testing.assert_allclose(picture[1:-1, 1:-1], planes[1:-1, 1:-1], atol=1e-12)
    flat = np.broadcast_to([0.9, 0.4, 0.1], planes.shape)
    picture = demosaic(np.take_along_axis(flat, channel_of, axis=2)[:, :, 0], pattern)
    np.testing.assert_allclose(picture, flat, atol=1e-12)
    noise = np.random.default_rng(1).random((20, 24))
    kept = np.take_along_axis(demosaic(noise, pattern), channel_of, axis=2)[:, :, 0]
    np.testing.assert_allclose(kept, noise, atol=1e-12)


def test_demosaicing_restores_the_picture_of_a_night() -> None:
    """A colour frame without noise, against its own channels before the filter array: structural similarity and ratio."""
    scenario = small_scenario(sensor={"colour": {"pattern": "GRBG"}, "noise": False}, camera__psf_sigma_px=1.2)
    expected = render_frame(scenario, 0).expected
    truth = np.stack([expected.channels[name] for name in ("red", "green", "blue")], axis=-1).astype(float)
    white = np.percentile(truth, 99.9)
    restored = demosaic(expected.electrons.astype(float) / white, "GRBG")
    shown, wanted = (srgb_encoded(np.clip(picture, 0, 1)) for picture in (restored, truth / white))
    assert structural_similarity(wanted, shown, channel_axis=2, data_range=1.0) > 0.97
    assert peak_signal_noise_ratio(wanted, shown, data_range=1.0) > 35


def test_development_is_srgb_of_the_share_of_full_scale() -> None:
    """Linear 0.2140 is sRGB 0.5, 127.5 of 255 (IEC 61966-2-1), black is 0 and full scale is 255."""
    sensor = SensorSpec(bits=12, black_level_dn=95, develop={"gamma": "srgb"})
    dn = np.array([[95, 0, 4095, 95 + 857]], dtype=np.uint16)
    assert develop(dn, sensor).tolist() == [[0, 0, 255, 128]]


def test_white_balance_makes_the_sky_grey_or_takes_the_given_factors() -> None:
    array = filter_array("RGGB", 40, 40)
    dn = np.choose(array, [100, 400, 200]).astype(np.uint16)
    sensor = SensorSpec(colour={"pattern": "RGGB"}, black_level_dn=0, develop={"gamma": "linear"})
    picture = develop(dn, sensor)
    assert picture[20, 20].tolist() == [round(255 * 400 / 4095)] * 3
    given = {"gamma": "linear", "white_balance": (1.0, 1.0, 2.0)}
    picture = develop(dn, SensorSpec(colour={"pattern": "RGGB"}, black_level_dn=0, develop=given))
    assert picture[20, 20].tolist() == [round(255 * value / 4095) for value in (200, 400, 200)]


def test_automatic_exposure_shows_the_sky_at_one_level_whatever_its_light() -> None:
    random = np.random.default_rng(1)
    sensor = SensorSpec(bits=12, black_level_dn=64, develop={"exposure": "auto"})
    means = []
    for sky_dn in (4, 40, 160):
        dn = np.rint(random.normal(64 + sky_dn, 0.05 * sky_dn + 0.3, (60, 80))).astype(np.uint16)
        dn[::20, ::20] = 4095
        picture = develop(dn, sensor)
        assert (picture[::20, ::20] == 255).all()
        means.append(float(np.median(picture)))
    assert means == pytest.approx([56] * 3, abs=5)
    bright = develop(np.full((60, 80), 2000, np.uint16), sensor)  # never darker than without
    assert (
        bright == develop(np.full((60, 80), 2000, np.uint16), SensorSpec(bits=12, black_level_dn=64, develop={}))
    ).all()
    assert not develop(np.full((60, 80), 64, np.uint16), sensor).any()


def test_automatic_exposure_of_a_colour_sensor_weighs_its_balanced_colours() -> None:
    array = filter_array("RGGB", 40, 40)
    sensor = SensorSpec(colour={"pattern": "RGGB"}, black_level_dn=0, develop={"exposure": "auto", "gamma": "linear"})
    for factor in (1, 3):
        picture = develop(np.choose(array, [10, 40, 20]).astype(np.uint16) * np.uint16(factor), sensor)
        assert picture[20, 20] == pytest.approx([255 * 0.04] * 3, abs=0.6)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("bright", "sensor.develop.exposure: found str 'bright', expected 'auto'"),
        (0, "exposure: found int 0, expected a value > 0"),
    ],
)
def test_other_exposures_are_refused(value, message) -> None:
    with pytest.raises(ScenarioError, match=message):
        small_scenario(sensor__develop={"exposure": value})


def test_head_up_display_covers_its_mask_and_nothing_else(tmp_path) -> None:
    plain = render_frame(small_scenario(sensor={"develop": {}}), 0)
    scenario = small_scenario(sensor={"develop": {}, "hud": True})
    covered = render_frame(scenario, 0)
    mask = covered.hud
    assert mask is not None
    assert 0.002 < mask.mean() < 0.1
    assert mask[90, 135]
    assert (covered.dn[mask] == 4095).all()
    np.testing.assert_array_equal(covered.dn[~mask], plain.dn[~mask])
    render_dataset(scenario, tmp_path / "frames")
    with Image.open(tmp_path / "frames" / "frame-00000-hud.png") as image:
        np.testing.assert_array_equal(np.array(image) == 255, mask)
    with Image.open(tmp_path / "frames" / "frame-00000-developed.png") as image:
        assert image.mode == "L"
        assert (np.array(image)[mask] == 255).all()
    assert (hud_mask(100, 80, ("A",)) != hud_mask(100, 80, ("B",))).any()
