"""Maker notes of telephones: bytes after the documented layout, axes after photographs whose tags are public."""

import io
import math
import struct

import numpy as np
import pytest
from PIL import Image
from small_scenes import small_scenario

from celnav.attitude import Attitude
from celnav.command.attitude_option import read_attitude
from celnav.command.exif import read_tags
from celnav.command.maker_note import acceleration_g, up_in_picture
from celnav.errors import AttitudeError
from generator.errors import ScenarioError
from generator.frame.render import render_frame
from generator.scenario.processing.develop_spec import GravitySpec
from generator.sensor.maker_note import accelerometer, apple_note

# Tags of photographs with ExifTool's dumps of them in public repositories: acceleration, orientation, whether it looks up.
PUBLISHED = {
    "iPhone 6 Plus": ((-0.9713176498, 0.05179892107, -0.1177288144), 1, False),
    "iPhone 15 Pro": ((-0.998894095, -0.03494079414, 0.1559448392), 1, True),
    "iPhone X": ((-0.8960353732, -0.07537551967, 0.4357159734), 1, True),
    "iPhone 7 Plus": ((0.1813890762, -0.8817955112, -0.4300854701), 6, False),
    "iPhone SE": ((-0.06026777624, -0.8702277539, -0.4827761948), 6, False),
}


def test_bytes_are_those_of_the_documented_layout() -> None:
    """Header of 14 bytes, directory of two entries, fractions behind it: offsets from the header's start, big-endian."""
    note = apple_note((-1.0, 0.25, 0.5))
    assert note[:14] == b"Apple iOS\x00\x00\x01MM"
    assert note[14:16] == b"\x00\x02"
    assert note[16:28] == b"\x00\x01\x00\x09\x00\x00\x00\x01\x00\x00\x00\x01"
    assert note[28:40] == b"\x00\x08\x00\x0a\x00\x00\x00\x03\x00\x00\x00\x2c"
    assert note[40:44] == bytes(4)
    assert struct.unpack(">6i", note[44:]) == (
        -100_000_000,
        100_000_000,
        25_000_000,
        100_000_000,
        50_000_000,
        100_000_000,
    )
    assert acceleration_g(note) == (-1.0, 0.25, 0.5)
    with pytest.raises(ValueError, match="beyond 20 g"):
        apple_note((21.0, 0.0, 0.0))


def test_a_note_in_the_other_byte_order_and_with_other_tags_is_read() -> None:
    """Written here after the same layout: little-endian, a text before the vector."""
    entries = struct.pack("<HHII", 0x0003, 2, 4, 7) + struct.pack("<HHII", 0x0008, 10, 3, 60)
    note = b"Apple iOS\x00\x00\x01II" + struct.pack("<H", 2) + entries + bytes(4) + bytes(16)
    assert acceleration_g(note + struct.pack("<6i", -3, 4, 1, 2, 0, 9)) == (-0.75, 0.5, 0.0)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_vertical_of_published_photographs_points_up_in_the_picture_as_shown(name) -> None:
    """The tag of orientation turns these pictures upright: up is within 15 deg of the shown picture's column, and ahead of
    the camera where it looked up."""
    acceleration, orientation, looks_up = PUBLISHED[name]
    right, down, ahead = up_in_picture(acceleration, orientation, turned=True)
    assert math.hypot(right, down, ahead) == pytest.approx(1)
    assert abs(math.degrees(math.atan2(right, -down))) < 15
    assert (ahead > 0) is looks_up


def test_the_default_offset_is_the_spread_of_published_lengths() -> None:
    """Rms of the vectors' length about 1 g: an axis' error, as the length has it along gravity alone."""
    rest = [(-0.9877620934, -0.004969268105, 0.02941340022), (-0.002876773242, -0.8244101994, -0.5708348155)]
    rest.append((-0.9088873265, -0.01614983752, -0.4305499197))
    lengths = np.array([math.hypot(*vector) for vector in [*rest, *(row[0] for row in PUBLISHED.values())]])
    assert 1000 * np.sqrt(np.mean((lengths - 1) ** 2)) == pytest.approx(GravitySpec().offset_mg, rel=0.1)


def test_offsets_belong_to_the_telephone_and_noise_to_the_frame() -> None:
    level = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    exact = GravitySpec(offset_mg=0, noise_mg=0)
    random = np.random.default_rng
    assert accelerometer(level, exact, random(0), random(1)) == pytest.approx((-1.0, 0.0, 0.0))
    fixed = GravitySpec(offset_mg=20, noise_mg=0)
    assert accelerometer(level, fixed, random(5), random(1)) == accelerometer(level, fixed, random(5), random(2))
    read = np.array(
        [
            accelerometer(level, GravitySpec(offset_mg=20, noise_mg=5), random(n), random(-n - 1 + 10**6))
            for n in range(2000)
        ]
    )
    # Standard errors are 1.6 % of sigma: five of them, a false alarm of 2e-6.
    assert read.std(axis=0) == pytest.approx([math.hypot(0.02, 0.005)] * 3, rel=0.08)


def photograph(tmp_path, form: str, orientation: int, **gravity):
    """A photograph of a telephone with a maker note."""
    photo = {"format": form, "orientation": orientation, "gravity": gravity, "lens": "back camera"}
    attitude = {"azimuth_deg": 210, "altitude_deg": 41, "roll_deg": 7}
    frame = render_frame(small_scenario(sensor={"colour": {}, "develop": {"photo": photo}}, attitude=attitude), 0)
    suffix = {"jpeg": "photo.jpg", "heif": "photo.heic"}[form]
    path = tmp_path / suffix
    path.write_bytes(frame.attached[suffix])
    return frame, path


@pytest.mark.parametrize(
    ("form", "orientation"), [("jpeg", 1), ("jpeg", 6), ("heif", 1), ("heif", 3), ("heif", 6), ("heif", 8)]
)
def test_the_solver_finds_the_vertical_of_the_pixels_that_it_reads(tmp_path, form, orientation) -> None:
    """Of a JPEG those as stored, of HEIF those that the decoder turns; true to the fractions' step."""
    frame, path = photograph(tmp_path, form, orientation, offset_mg=0, noise_mg=0)
    x, y, z = frame.plan.motion.R_mid[:, 2]
    turned = {1: (x, y), 3: (-x, -y), 6: (-y, x), 8: (y, -x)}[orientation if form == "heif" else 1]
    found = read_tags(path)
    assert found.up == pytest.approx((*turned, z), abs=3e-8)
    attitude = read_attitude("exif,tilt_sigma=0.2", found.up)
    assert attitude == Attitude.up(found.up, 0.2)
    assert read_attitude("exif", found.up).tilt_deg == 0.6


def test_pillow_hands_the_note_on(tmp_path) -> None:
    frame, path = photograph(tmp_path, "jpeg", 1)
    with Image.open(path) as image:
        note = image.getexif().get_ifd(0x8769)[0x927C]
    assert note.startswith(b"Apple iOS\x00")
    assert b"\x92\x7c\x00\x07" + len(note).to_bytes(4) in path.read_bytes()[:2000]
    assert 0.0005 < math.dist(acceleration_g(note), np.array([0, 0, 0]) + frame.plan.motion.R_mid[[1, 0, 2], 2]) < 0.08
    again, _ = photograph(tmp_path, "jpeg", 1)
    assert again.attached == frame.attached


def test_what_says_nothing_of_the_vertical_is_left_out(tmp_path) -> None:
    """Falling, shaken, damaged, another maker's; the front camera's; turned by a program, which leaves it upright."""
    assert up_in_picture((0.1, 0.1, 0.1), 1, False) is None
    assert up_in_picture((-1.3, 0.0, 0.0), 1, False) is None
    assert up_in_picture((-1.0, 0.0, 0.0), 5, True) is None
    whole = apple_note((-1.0, 0.0, 0.0))
    for note in (
        None,
        "Apple iOS",
        b"",
        whole[:40],
        whole[:60],
        b"Apple iOS\x00\x00\x01XX" + whole[14:],
        whole[:48] + bytes(20),
    ):
        assert acceleration_g(note) is None
    _, path = photograph(tmp_path, "jpeg", 1)
    with Image.open(path) as image:
        exif = image.getexif()
        image.rotate(90, expand=True).save(tmp_path / "turned.jpg", exif=exif)
        exif.get_ifd(0x8769)[0xA434] = "front camera"
        image.save(tmp_path / "front.jpg", exif=exif)
    for name in ("turned.jpg", "front.jpg"):
        assert read_tags(tmp_path / name).up is None
    with pytest.raises(AttitudeError, match="AccelerationVector"):
        read_attitude("exif", None)
    with pytest.raises(AttitudeError, match="tilt_sigma = 'x' must be a number"):
        read_attitude("exif,tilt_sigma=x", (0.0, -1.0, 0.0))


def test_other_makers_are_refused() -> None:
    with pytest.raises(ScenarioError, match=r"photo\.gravity\.form"):
        small_scenario(sensor={"develop": {"photo": {"gravity": {"form": "pixel"}}}})


def test_a_picture_without_gravity_has_no_note() -> None:
    plain = render_frame(small_scenario(sensor={"develop": {"photo": {}}}), 0)
    with Image.open(io.BytesIO(plain.attached["photo.jpg"])) as image:
        assert 0x927C not in image.getexif().get_ifd(0x8769)
