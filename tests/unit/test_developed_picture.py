"""The 8-bit picture and the head-up display."""

import numpy as np
from PIL import Image
from small_scenes import small_scenario

from generator.frame.render import render_dataset, render_frame
from generator.scenario.sensor_spec import SensorSpec
from generator.sensor.colour import filter_array
from generator.sensor.develop import demosaic, develop
from generator.sensor.hud import hud_mask


def test_demosaicing_a_flat_colour_and_a_ramp_is_exact() -> None:
    """Bilinear interpolation reproduces what is linear, away from the mirrored edges."""
    v, u = np.mgrid[0:20, 0:24].astype(float)
    planes = {"R": 0.2 + 0.01 * u, "G": 0.3 + 0.005 * v, "B": np.full(u.shape, 0.1)}
    array = filter_array("BGGR", 20, 24)
    raw = np.choose(array, [planes["B"], planes["G"], planes["R"]])
    picture = demosaic(raw, "BGGR")
    for channel, letter in enumerate("RGB"):
        np.testing.assert_allclose(picture[2:-2, 2:-2, channel], planes[letter][2:-2, 2:-2], atol=1e-12)


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
