"""Photographs' files: pixels, tags read back by Pillow and by the solver, and what is refused."""

import io

import numpy as np
import pytest
from PIL import Image
from small_scenes import small_scenario

from celnav.command.exif import read_tags
from celnav.command.exposure_time import exposure_time
from celnav.command.photo_camera import photo_camera
from celnav.reading.image_file import read_image
from generator.dataset.images import photo
from generator.errors import GeneratorError, ScenarioError
from generator.frame.plan import plan_frame
from generator.frame.render import render_frame
from generator.scenario.processing.develop_spec import PhotoSpec
from generator.scenario.sensor_spec import SensorSpec
from generator.sensor.develop import develop
from generator.sensor.photo import Taken, tags

SENSOR = {
    "colour": {},
    "develop": {
        "gamma": 2.2,
        "exposure": 4.0,
        "photo": {
            "utc_offset": "-03:30", "gps": True, "pointing": True, "orientation": 6, "make": "Sky", "camera": "Sky 1",
            "lens": "24mm f/2", "quality": 95, "subsampling": "4:4:4",
        },
    },
}  # fmt: skip
CAMERA = {
    "camera__hfov_deg": 70,
    "camera__pixel_pitch_um": 5.0,
    "attitude": {"azimuth_deg": 210.25, "altitude_deg": 48.5},
}


@pytest.fixture(scope="module")
def frame():
    return render_frame(small_scenario(sensor=SENSOR, time__utc_start="2020-01-15T20:00:00.123456Z", **CAMERA), 0)


@pytest.fixture(scope="module")
def path(frame, tmp_path_factory):
    place = tmp_path_factory.mktemp("photo") / "photo.jpg"
    place.write_bytes(frame.attached["photo.jpg"])
    return place


def test_pixels_are_those_of_the_developed_picture_to_the_coding(frame, path) -> None:
    """As stored, whatever the orientation; the same bytes again."""
    pixels = photo(frame.attached["photo.jpg"], (180, 270)).astype(float)
    assert np.sqrt(np.mean((pixels - frame.developed) ** 2)) < 3
    np.testing.assert_array_equal(read_image(path), pixels)
    again = render_frame(frame.plan.scenario, 0)
    assert again.attached == frame.attached
    assert again.stars.equals(frame.stars)


def test_the_solver_finds_time_and_camera_in_the_tags(frame, path) -> None:
    found = read_tags(path)
    assert (found.camera, found.lens, found.orientation, found.exposure_s) == ("Sky 1", "24mm f/2", 6, 0.5)
    when = exposure_time(found, None, None)
    assert when.utc == "2020-01-15T20:00:00.373456Z" == frame.plan.utc_mid.isoformat()
    assert str(found.gps_utc) == "2020-01-15 20:00:00.123456+00:00"
    camera = photo_camera(found).camera
    assert camera.f_px == pytest.approx(frame.plan.spec.camera.f_px, rel=1e-4)
    assert found.focal_length_35mm == pytest.approx(
        frame.plan.spec.camera.f_px * np.hypot(36, 24) / np.hypot(270, 180), abs=0.5
    )


def test_position_and_pointing_are_read_by_pillow(frame, path) -> None:
    with Image.open(path) as image:
        exif = image.getexif()
        where, taken = exif.get_ifd(0x8825), exif.get_ifd(0x8769)
    degrees, minutes, seconds = (float(part) for part in where[2])
    assert (where[1], degrees + minutes / 60 + seconds / 3600) == ("N", pytest.approx(52.0, abs=1e-7))
    degrees, minutes, seconds = (float(part) for part in where[4])
    assert (where[3], degrees + minutes / 60 + seconds / 3600) == ("E", pytest.approx(4.36, abs=1e-7))
    assert (where[16], float(where[17]), float(taken[0x9405])) == ("T", 210.25, 48.5)
    assert taken[0x9003] == "2020:01:15 16:30:00"
    assert float(taken[0x829D]) == pytest.approx(frame.plan.spec.camera.f_px * 0.005 / 4, abs=0.01)


def test_tags_that_are_not_asked_for_are_absent() -> None:
    sensor = {"develop": {"photo": {"clock_error_s": 2.5}}}
    plain = render_frame(small_scenario(sensor=sensor), 0)
    with Image.open(io.BytesIO(plain.attached["photo.jpg"])) as image:
        assert image.mode == "L"
        exif = image.getexif()
        assert not exif.get_ifd(0x8825)
        taken = exif.get_ifd(0x8769)
    assert {0x9405, 0x920A, 0xA20E}.isdisjoint(taken)
    assert (taken[0x9003], taken[0x9291]) == ("2020:01:15 20:00:02", "500000")


@pytest.mark.parametrize(
    ("longitude_deg", "side", "size_deg"),
    [(190.0, "W", 170.0), (359.5, "W", 0.5), (360.0, "E", 0.0), (180.0, "E", 180.0), (-180.0, "W", 180.0)],
)
def test_longitudes_are_within_half_a_circle_of_greenwich(longitude_deg, side, size_deg) -> None:
    plan = plan_frame(small_scenario(site__longitude_deg=longitude_deg), 0)
    how = Taken(plan.spec, plan.utc_start.isoformat(), plan.spec.attitude)
    where = tags(how, PhotoSpec(gps=True)).get_ifd(0x8825)
    degrees, minutes, seconds = (float(part) for part in where[4])
    assert (where[3], degrees + minutes / 60 + seconds / 3600) == (side, pytest.approx(size_deg, abs=1e-7))


def test_a_leap_second_is_shown_as_the_second_after() -> None:
    plan = plan_frame(small_scenario(time__utc_start="2016-12-31T23:59:60.25Z"), 0)
    how = Taken(plan.spec, plan.utc_start.isoformat(), plan.spec.attitude)
    taken = tags(how, PhotoSpec()).get_ifd(0x8769)
    assert (taken[0x9003], taken[0x9291]) == ("2017:01:01 00:00:00", "250000")


def test_a_power_is_the_transfer_curve_and_sharpening_comes_after_it() -> None:
    dn = np.array([[0, 1024, 2047, 4095]], dtype=np.uint16)
    sensor = SensorSpec(bits=12, black_level_dn=0, develop={"gamma": 2.0})
    assert develop(dn, sensor).tolist() == [[0, 128, 180, 255]]
    step = np.repeat(np.array([1000, 2000], np.uint16), 12)[None].repeat(12, axis=0)
    plain, sharp = (
        develop(step, SensorSpec(bits=12, black_level_dn=0, develop={"gamma": "linear"} | more)).astype(int)
        for more in ({}, {"sharpen": {"amount": 1.0, "sigma_px": 1.5}})
    )
    assert sharp[6, 12] > plain[6, 12] + 10
    assert sharp[6, 11] < plain[6, 11] - 10
    np.testing.assert_array_equal(sharp[:, [0, 23]], plain[:, [0, 23]])


def test_noise_reduction_comes_before_the_transfer_curve() -> None:
    noise = np.random.default_rng(0).normal(2000, 300, (200, 200)).astype(np.uint16)
    spreads = [
        develop(noise, SensorSpec(bits=12, black_level_dn=0, develop={"gamma": "linear"} | more)).std()
        for more in ({}, {"denoise": {"sigma_px": 1.5}})
    ]
    assert spreads[1] / spreads[0] == pytest.approx(1 / (3 * np.pi**0.5), rel=0.05)


def test_damaged_and_strange_files_are_refused(frame) -> None:
    content = frame.attached["photo.jpg"]
    for data, shape in ((content, (180, 271)), (content[: len(content) // 2], (180, 270)), (b"no picture", None)):
        with pytest.raises(GeneratorError, match="JPEG"):
            photo(data, shape)


REFUSED = {
    "offset": ({"utc_offset": "2 h"}, "offset from UTC"),
    "orientation": ({"orientation": 9}, "sensor.develop.photo.orientation"),
    "name": ({"make": "Ψ"}, "60 characters of ASCII"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_bad_photos_are_refused(case) -> None:
    values, fragment = REFUSED[case]
    with pytest.raises(ScenarioError, match=fragment):
        small_scenario(sensor={"develop": {"photo": values}})
