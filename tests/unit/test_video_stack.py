"""The video camera: stacks against plain loops, the codec against its input, parts of an exposure against the whole."""

import io

import numpy as np
import pytest
from astropy.io import fits
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.exposure.parts import plan_part
from generator.frame.object_table import object_table
from generator.frame.plan import plan_frame
from generator.frame.render import render_frame
from generator.frame.video.codec import decode, encode
from generator.frame.video.exposures import moving_light, video_frames
from generator.frame.video.stack import PICTURES, fits_bytes, stack
from generator.scenario.processing.video_spec import H264Spec, SharpenSpec, VideoDenoiseSpec
from generator.sensor.processing import averaged, denoised, sharpened

VIDEO = {"bits": 10, "gain_e_per_dn": 2.0, "black_level_dn": 20, "video": {"frames_per_s": 10, "keep": True}}


def pile(count: int = 40, shape: tuple[int, int] = (6, 8)) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 40, (count, *shape)).astype(np.uint8)


def test_a_stack_is_what_the_format_of_meteor_networks_says() -> None:
    """Pixel by pixel with whole numbers: without the maximum, mean rounded down, variance about the rounded mean."""
    frames = pile()
    found = stack(iter(frames), np.random.default_rng(0))
    for v, u in np.ndindex(frames.shape[1:]):
        values = sorted(int(value) for value in frames[:, v, u])
        highest, rest = values[-1], values[:-1]
        mean = sum(rest) // len(rest)
        variance = (sum(value * value for value in rest) - sum(rest) * mean) // (len(rest) - 1)
        assert found.maximum[v, u] == highest
        assert frames[found.maximum_frame[v, u], v, u] == highest
        assert found.mean[v, u] == mean
        assert found.deviation[v, u] == max(int(variance**0.5), 1)


def test_of_equal_maxima_each_is_as_likely() -> None:
    """Chi squared over eight equal frames at a false alarm of 1e-4."""
    frames = [np.full((200, 200), 7, np.uint8)] * 8
    counts = np.bincount(stack(frames, np.random.default_rng(5)).maximum_frame.ravel(), minlength=8)
    assert ((counts - 5000) ** 2 / 5000).sum() < 30


@pytest.mark.parametrize("count", [2, 257])
def test_other_numbers_of_frames_are_refused(count) -> None:
    with pytest.raises(ValueError, match="3 to 256"):
        stack([np.zeros((2, 2), np.uint8)] * count, np.random.default_rng(0))


def test_the_file_has_the_networks_extensions() -> None:
    found = stack(pile(), np.random.default_rng(0))
    content = fits_bytes(found, 25.0, "skybench")
    assert content == fits_bytes(found, 25.0, "skybench")
    with fits.open(io.BytesIO(content)) as file:
        assert tuple(unit.name for unit in file[1:]) == PICTURES
        assert all(unit.data.dtype == np.uint8 for unit in file[1:])
        header = file[0].header
        assert [header[key] for key in ("NROWS", "NCOLS", "NBITS", "NFRAMES", "FPS")] == [6, 8, 8, 40, 25.0]
        np.testing.assert_array_equal(file["AVEPIXEL"].data, found.mean)
        np.testing.assert_array_equal(file["MAXFRAME"].data, found.maximum_frame)


def test_the_codec_gives_back_what_it_is_given() -> None:
    """Lossless at a rate factor of 0, all 256 values included; within some values at a coarse one; always the same bytes."""
    ramp = np.tile(np.arange(256, dtype=np.uint8), (64, 1))
    frames = [np.roll(ramp, shift, axis=1) for shift in range(6)]
    video = encode(frames, (64, 256), 25.0, H264Spec(crf=0))
    np.testing.assert_array_equal(list(decode(video)), frames)
    assert video == encode(frames, (64, 256), 25.0, H264Spec(crf=0))
    noise = [np.random.default_rng(n).normal(100, 6, (64, 256)).astype(np.uint8) for n in range(12)]
    coarse = np.array(list(decode(encode(noise, (64, 256), 25.0, H264Spec(crf=30)))), float)
    assert len(coarse) == 12
    assert abs(coarse.mean() - np.mean(noise)) < 0.7
    # Coding takes noise away and leaves neighbours alike.
    assert coarse.std(axis=0).mean() < 0.7 * np.std(noise, axis=0).mean()
    white, coded = np.array(noise[0], float) - 100, coarse[0] - coarse[0].mean()
    assert (
        (coded[:, 1:] * coded[:, :-1]).mean() / coded.var() > 0.2 > (white[:, 1:] * white[:, :-1]).mean() / white.var()
    )


def test_a_bit_rate_is_held() -> None:
    noise = [np.random.default_rng(n).normal(100, 10, (128, 128)).astype(np.uint8) for n in range(50)]
    for rate in (200.0, 800.0):
        size = len(encode(noise, (128, 128), 25.0, H264Spec(bitrate_kbit_s=rate)))
        assert 8 * size / 2.0 / 1000 == pytest.approx(rate, rel=0.35)


def test_noise_reduction_smooths_noise_and_keeps_stars() -> None:
    noise = 0.01 * np.random.default_rng(1).standard_normal((400, 400)).astype(np.float32)
    # White noise through a Gaussian has a standard deviation of 1 / (2 sigma sqrt(pi)).
    assert denoised(noise, VideoDenoiseSpec(sigma_px=1.5)).std() == pytest.approx(0.01 / (3 * np.pi**0.5), rel=0.02)
    star = np.zeros((21, 21), np.float32)
    star[10, 10] = 0.8
    kept = denoised(star, VideoDenoiseSpec(sigma_px=1.5, threshold=0.05))
    assert kept[10, 10] > 0.78
    assert denoised(star, VideoDenoiseSpec(sigma_px=1.5))[10, 10] < 0.1


def test_averaging_over_frames_has_the_filters_variance() -> None:
    spec, before = VideoDenoiseSpec(sigma_px=1.0, temporal=0.6), None
    for number in range(30):
        before = averaged(np.random.default_rng(number).standard_normal((300, 300)).astype(np.float32), before, spec)
    assert before.std() == pytest.approx((0.4 / 1.6) ** 0.5, rel=0.02)


def test_sharpening_is_an_unsharp_mask() -> None:
    edge = np.repeat(np.array([0.2, 0.8], np.float32), 20)[None].repeat(9, axis=0)
    sharp = sharpened(edge, SharpenSpec(amount=1.0, sigma_px=2.0))
    assert sharp[4, 20] > 0.9
    assert sharp[4, 19] < 0.1
    np.testing.assert_allclose(sharp[4, [0, 39]], [0.2, 0.8], atol=1e-3)


def test_parts_of_an_exposure_add_up_to_it() -> None:
    """Expected electrons of four parts, a meteor's too, within single precision and the sky's curvature."""
    meteor = {
        "kind": "meteor", "v_mag": -2, "start_s": 2.0, "end_s": 5.0,
        "start": {"azimuth_deg": 170, "altitude_deg": 80}, "end": {"azimuth_deg": 200, "altitude_deg": 75},
    }  # fmt: skip
    plan = plan_frame(small_scenario(time__exposure_s=8.0, foreground={"trails": [meteor]}), 0)
    whole = render_expected(plan)
    parts = sum(render_expected(plan_part(plan, k / 4, (k + 1) / 4)).electrons.astype(float) for k in range(4))
    assert parts.sum() == pytest.approx(whole.electrons.sum(), rel=1e-4)
    assert np.abs(parts - whole.electrons).max() < 0.02 * whole.electrons.max()


def test_a_frame_of_video_is_a_stack_of_its_frames() -> None:
    """The mean follows the expected light; the frame alone has the same bytes; a meteor is in its own frames alone."""
    meteor = {
        "kind": "meteor", "v_mag": -4, "start_s": 1.0, "end_s": 1.5,
        "start": {"azimuth_deg": 80, "altitude_deg": 70}, "end": {"azimuth_deg": 90, "altitude_deg": 70},
    }  # fmt: skip
    scenario = small_scenario(time__exposure_s=4.0, sensor=VIDEO, foreground={"trails": [meteor]})
    frame = render_frame(scenario, 0)
    assert set(frame.attached) == {"stack.fits", "video.mp4"}
    assert render_frame(scenario, 0).attached == frame.attached
    with fits.open(io.BytesIO(frame.attached["stack.fits"])) as file:
        when, highest = file["MAXFRAME"].data, file["MAXPIXEL"].data
        np.testing.assert_array_equal(file["AVEPIXEL"].data, frame.dn)
    row = frame.objects.to_pandas().iloc[0]
    assert row["kind"] == "meteor"
    around_v, around_u = (round(row[f"centroid_{axis}_px"]) + np.arange(-3, 4) for axis in "vu")
    near = np.ix_(around_v, around_u)
    place = np.unravel_index(np.argmax(highest[near].astype(int) - frame.dn[near]), (7, 7))
    v, u = around_v[place[0]], around_u[place[1]]
    assert highest[v, u] > frame.dn[v, u] + 50.0
    assert 10 <= when[v, u] < 15
    frames = np.array(list(video_frames(frame.plan, frame.plan.spec.sensor.video)), float)
    assert frames.shape[0] == 40
    quiet = np.delete(np.arange(40), range(9, 16))
    assert frames[quiet, v, u].max() < highest[v, u] - 50.0
    # Neutral pixels, in electrons of all frames, by the record's own gain and black level.
    expected = np.median(frame.expected.electrons + 4.0 * frame.plan.spec.sensor.mean_dark_e_s)
    gain = 40 * 2.0 * 1023 / 255
    assert (np.median(frames.mean(axis=0)) - 20 * 255 / 1023) * gain == pytest.approx(expected, rel=0.1, abs=0.1 * gain)


def test_moving_light_is_that_of_what_moves_alone() -> None:
    """A lamp, lit windows and stars too faint for the truth shine once: they are among what stands still."""
    meteor = {
        "kind": "meteor", "v_mag": -2, "start_s": 0.0, "end_s": 4.0,
        "start": {"azimuth_deg": 80, "altitude_deg": 70}, "end": {"azimuth_deg": 90, "altitude_deg": 70},
    }  # fmt: skip
    lamp = {"azimuth_deg": 100, "altitude_deg": 60, "distance_m": 60, "intensity_cd": 60, "kind": "HPS"}
    common = {"time__exposure_s": 4.0, "sensor": VIDEO, "stars__listed_magnitude": 5.0}
    lit = {"trails": [meteor], "lamps": [lamp], "landscape": {"skyline": ["street"], "variant": 1}}
    dark, street = (plan_frame(small_scenario(**common, foreground=what), 0) for what in ({"trails": [meteor]}, lit))
    alone, beside = moving_light(dark, 0.25, 0.5), moving_light(street, 0.25, 0.5)
    assert alone is not None
    assert beside is not None
    assert alone.max() > 100.0
    np.testing.assert_allclose(beside, alone, rtol=1e-5, atol=1e-4 * alone.max())
    assert beside.sum() == pytest.approx(alone.sum(), rel=1e-3)


REFUSED = {
    "frames": ({"video": {"frames_per_s": 7}}, "whole number of frames"),
    "rate": ({"video": {"h264": {"bitrate_kbit_s": 1}}}, "sensor.video.h264.bitrate_kbit_s"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_bad_videos_are_refused(case) -> None:
    values, fragment = REFUSED[case]
    with pytest.raises(ScenarioError, match=fragment):
        small_scenario(sensor=values, time__exposure_s=3.3)


DARK_ROOM = {
    "time__exposure_s": 2.0, "sky__bortle": None, "stars": {"limiting_magnitude": -2, "planets": False},
    "camera": {"width": 60, "height": 40, "hfov_deg": 30, "aperture_mm": 4},
}  # fmt: skip
PLAIN = {
    "bits": 8, "gain_e_per_dn": 10.0, "black_level_dn": 20, "read_noise_e": 0.0, "dark_current_e_s": 0.0, "prnu": 0.0,
    "dsnu_e": 0.0, "video": {"frames_per_s": 10, "codec": "none"},
}  # fmt: skip


def dark_video(**sensor):
    """Electrons in the frames of a video without light, and the truth of its objects."""
    plan = plan_frame(small_scenario(**DARK_ROOM, sensor=PLAIN | sensor), 0)
    frames = np.array(list(video_frames(plan, plan.spec.sensor.video)))
    return 10.0 * (frames - 20.0), object_table(plan, render_expected(plan)).to_pandas()


def test_the_cosmic_rays_told_of_a_video_are_those_of_its_frames() -> None:
    """Tracks of a pixel: those pixels are lit, with that charge, and no others."""
    light, rows = dark_video(cosmic_rays={"rate_s": 15.0, "charge_e_px": 500.0, "length_px": 0.001})
    assert len(rows) > 15
    told = np.zeros(light.shape[1:])
    np.add.at(
        told, tuple(np.rint(rows[["centroid_v_px", "centroid_u_px"]].to_numpy()).astype(int).T), rows["electrons_e"]
    )
    np.testing.assert_allclose(light.sum(axis=0), told, atol=10.0)
    assert ((light > 0).sum(axis=(1, 2)) > 0).sum() > 5


def test_blinking_pixels_of_a_video_are_told_over_all_its_frames() -> None:
    """Their charge, within 6 standard deviations of its shot noise and the rounding of 20 frames."""
    blinking = {"fraction": 0.02, "amplitude_e_s": 2000.0, "time_constant_s": [0.05, 0.1]}
    light, rows = dark_video(blinking_pixels=blinking, temperature_c=20.0, dark_reference_c=20.0)
    assert len(rows) > 10
    seen = light.sum(axis=0)[tuple(rows[["centroid_v_px", "centroid_u_px"]].to_numpy().astype(int).T)]
    told = rows["electrons_e"].to_numpy()
    assert (np.abs(seen - told) < 6 * np.sqrt(told + 20 * 100 / 12)).all()
