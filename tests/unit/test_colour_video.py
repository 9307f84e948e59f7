"""Videos of colour cameras: BT.709 against published bars and another converter, the file's own words, and the stack."""

import io
from fractions import Fraction

import av
import numpy as np
import pytest
from astropy.io import fits
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.record import sensor_object
from generator.frame.render import render_frame
from generator.frame.video import codec
from generator.frame.video.codec import colour_planes, decode, encode, grey
from generator.frame.video.exposures import grey_sky, in_colour, video_frames
from generator.scenario.processing.video_spec import H264Spec
from generator.sensor.colour import filter_array

# Bars of 75 % in 8-bit BT.709 as test signals have them (SMPTE RP 219): luma, blue difference, red difference.
BARS = {
    (191, 191, 191): (180, 128, 128), (191, 191, 0): (168, 44, 136), (0, 191, 191): (145, 147, 44),
    (0, 191, 0): (133, 63, 52),
    (191, 0, 191): (63, 193, 204), (191, 0, 0): (51, 109, 212), (0, 0, 191): (28, 212, 120), (0, 0, 0): (16, 128, 128),
    (255, 255, 255): (235, 128, 128),
}  # fmt: skip
VIDEO = {
    "colour": {},
    "bits": 10,
    "gain_e_per_dn": 0.5,
    "black_level_dn": 20,
    "video": {"frames_per_s": 10, "keep": True},
}


@pytest.mark.parametrize("colour", BARS)
def test_colours_of_test_bars_have_their_published_values(colour) -> None:
    planes = colour_planes(np.broadcast_to(np.array(colour, np.uint8), (4, 8, 3)))
    assert planes.shape == (6, 8)
    assert (planes[:4].min(), planes[4].max(), planes[5].min()) == BARS[colour]
    assert planes[:4].max() == planes[:4].min()


def test_luma_is_that_of_exact_arithmetic() -> None:
    """Halves are rounded up; a sum of floating-point numbers lands on either side of them."""
    frame = np.random.default_rng(1).integers(0, 256, (20, 40, 3)).astype(np.uint8)
    frame[0] = [13, 0, 121]
    weights = Fraction(2126, 10000), Fraction(7152, 10000), Fraction(722, 10000)
    exact = [sum(w * int(x) for w, x in zip(weights, colour, strict=True)) for colour in frame.reshape(-1, 3)]
    half = Fraction(1, 2)
    assert exact[0] % 1 == half
    np.testing.assert_array_equal(grey(frame).ravel(), [int(luma + half) for luma in exact])
    narrow = [int(16 + 219 * luma / 255 + half) for luma in exact]
    np.testing.assert_array_equal(colour_planes(frame)[:20].ravel(), narrow)


@pytest.mark.parametrize("rate", [{"crf": 23}, {"bitrate_kbit_s": 400}])
def test_a_video_has_the_same_bytes_on_any_processor(monkeypatch, rate) -> None:
    """x264 told to do without the processor's extensions, as on a processor that lacks them."""
    still = np.random.default_rng(5).integers(0, 60, (96, 128))
    noise = np.random.default_rng(6)
    frames = [(still + noise.normal(60, 4, still.shape)).astype(np.uint8) for _ in range(25)]
    here = encode(frames, (96, 128), 25.0, H264Spec(**rate))
    monkeypatch.setattr(codec, "EVERY_PROCESSOR", f"{codec.EVERY_PROCESSOR}:asm=0")
    assert encode(frames, (96, 128), 25.0, H264Spec(**rate)) == here


def test_another_converter_finds_the_colours_again() -> None:
    """swscale, told the same matrix and range, from our planes back to RGB: smooth colours within two steps of 255."""
    v, u = np.mgrid[0:96, 0:128] / 128
    smooth = np.rint(255 * np.stack([u, v, 1 - u], axis=-1)).astype(np.uint8)
    frame = av.VideoFrame.from_ndarray(colour_planes(smooth), format="yuv420p")
    frame.colorspace, frame.color_range = 1, 1
    back = frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray().astype(int)
    assert np.abs(back - smooth)[4:-4, 4:-4].mean() < 2.0
    assert np.percentile(np.abs(back - smooth), 99) <= 4
    # With the matrix of BT.601 the same planes are other colours.
    wrong = frame.reformat(format="rgb24", src_colorspace="ITU601").to_ndarray().astype(int)
    assert np.abs(wrong - smooth).mean() > 4


def test_the_file_says_its_colours_and_the_luma_comes_back() -> None:
    random = np.random.default_rng(4)
    frames = [random.integers(0, 256, (48, 64, 3)).astype(np.uint8) for _ in range(4)]
    video = encode(frames, (48, 64), 25.0, H264Spec(crf=0))
    with av.open(io.BytesIO(video)) as container:
        context = container.streams.video[0].codec_context
        assert (context.pix_fmt, context.color_range, context.colorspace) == ("yuv420p", 1, 1)
        assert (context.color_primaries, context.color_trc) == (1, 1)
    found = np.array(list(decode(video)), int)
    wanted = np.array([grey(frame) for frame in frames], int)
    assert np.abs(found - wanted).max() <= 1
    assert video == encode(frames, (48, 64), 25.0, H264Spec(crf=0))


def test_white_balance_makes_the_sky_grey_over_the_black_level() -> None:
    pattern = "GRBG"
    light = np.choose(filter_array(pattern, 40, 60), [0.02, 0.05, 0.04]).astype(np.float32)
    factors = grey_sky(light, pattern)
    assert factors == pytest.approx((1.25, 1.0, 2.5))
    picture = in_colour(light + np.float32(0.1), 0.1, pattern, factors)
    np.testing.assert_allclose(picture, 0.15, atol=1e-6)
    assert grey_sky(np.zeros((4, 4), np.float32), pattern) == (1.0, 1.0, 1.0)


def test_a_colour_camera_gives_a_colour_video_and_a_grey_stack() -> None:
    """The stack is that of the luma; its mean follows the expected light of green by the record's own gain."""
    scenario = small_scenario(time__exposure_s=4.0, sensor=VIDEO)
    frame, again = render_frame(scenario, 0), render_frame(scenario, 0)
    spec = frame.plan.spec.sensor.video
    pure = np.array(list(video_frames(frame.plan, spec)))
    # Where the files differ, these tell whether light, pictures or coding do.
    np.testing.assert_array_equal(again.expected.electrons, frame.expected.electrons)
    np.testing.assert_array_equal(list(video_frames(again.plan, spec)), pure)
    assert encode(pure, (180, 270), 10.0, spec.h264) == frame.attached["video.mp4"]
    assert again.attached == frame.attached
    with av.open(io.BytesIO(frame.attached["video.mp4"])) as container:
        shown = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)]
    assert len(shown) == 40
    medians = np.median(shown, axis=(0, 1, 2))
    assert medians.max() - medians.min() <= 2
    assert pure.shape == (40, 180, 270, 3)
    with fits.open(io.BytesIO(frame.attached["stack.fits"])) as file:
        np.testing.assert_array_equal(file["AVEPIXEL"].data, frame.dn)
        assert file["MAXPIXEL"].data.max() > 3 * np.median(frame.dn)
    sensor = sensor_object(frame.plan.spec.sensor, 4.0)
    assert sensor["bayer_pattern"] is None
    green = np.median(frame.expected.electrons[filter_array("RGGB", 180, 270) == 1])
    luma = np.mean([grey(picture) for picture in pure], axis=0)
    expected = green + 4.0 * frame.plan.spec.sensor.mean_dark_e_s
    assert (np.median(luma) - sensor["black_level_dn"]) * sensor["gain_e_per_dn"] == pytest.approx(expected, rel=0.1)


def test_stars_keep_their_colours_in_the_video() -> None:
    """Red over blue of the bright stars that do not saturate follows their B-V."""
    video = VIDEO | {"noise": False, "video": VIDEO["video"] | {"white_balance": [1.0, 1.0, 1.0], "codec": "none"}}
    frame = render_frame(small_scenario(time__exposure_s=4.0, sensor=video, camera__psf_sigma_px=1.2), 0)
    mean = np.mean(list(video_frames(frame.plan, frame.plan.spec.sensor.video)), axis=0)
    stars = frame.stars.to_pandas()
    inside = (stars.u_px.between(6, 263)) & (stars.v_px.between(6, 173)) & (stars.v_mag < 2.1)
    ratio, colour = [], []
    for star in stars[inside].itertuples():
        near = mean[round(star.v_px) - 4 : round(star.v_px) + 5, round(star.u_px) - 4 : round(star.u_px) + 5]
        if near.max() > 240:
            continue
        light = (near - np.median(near, axis=(0, 1))).sum(axis=(0, 1))
        ratio.append(light[0] / max(light[2], 10))
        colour.append(star.bv_mag)
    assert len(ratio) > 8
    assert np.corrcoef(np.log(ratio), colour)[0, 1] > 0.8


@pytest.mark.parametrize(
    ("values", "fragment"),
    [
        ({"video": {"white_balance": [1, 1, 1]}}, "white_balance is of colour sensors"),
        ({"video": {"white_balance": [0, 1, 1]}, "colour": {}}, r"sensor\.video\.white_balance"),
        ({"video": {}, "colour": {}, "develop": {}}, "video and develop exclude each other"),
    ],
)
def test_bad_colour_videos_are_refused(values, fragment) -> None:
    with pytest.raises(ScenarioError, match=fragment):
        small_scenario(sensor=values, time__exposure_s=4.0)
