"""Photographs: their tags, the time and the camera that follow from them, and tags that lie."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

import celnav
from celnav.attitude import Attitude
from celnav.command.exif import PhotoTags, read_tags
from celnav.command.exposure_time import exposure_time
from celnav.command.photo_camera import photo_camera
from celnav.command.solving import MIRRORED, _Lens, _of_attitude, _with_hint_of_other_lens
from celnav.detections import Detections
from celnav.errors import CameraError, ImageError, TimeError
from celnav.fix import Fix, Reason
from celnav.reading.image_file import refuse_raw

TAKEN = datetime(2023, 10, 14, 22, 0, 0)
TAGS = PhotoTags(6000, 4000, taken=TAKEN, exposure_s=8.0, focal_length_mm=24.0, focal_length_35mm=24.0)


def photograph(path, base=None, photo=None, gps=None, size=(64, 48)):
    exif = Image.Exif()
    exif.update(base or {})
    exif.get_ifd(0x8769).update(photo or {})
    exif.get_ifd(0x8825).update(gps or {})
    Image.new("L", size).save(path, exif=exif.tobytes())
    return path


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_tags_of_a_photograph(tmp_path, suffix) -> None:
    path = photograph(
        tmp_path / f"p.{suffix}",
        {0x0110: "Sky 1", 0x0112: 1 if suffix == "tif" else 6},
        {
            0x9003: "2023:10:14 22:00:00", 0x9291: "25", 0x9011: "+02:00", 0x829A: IFDRational(5, 2),
            0x920A: IFDRational(24, 1), 0xA405: 36, 0xA20E: IFDRational(6000, 1), 0xA210: 3, 0xA002: 128,
            0xA434: "24mm F2\x1b[2J",
        },
        {29: "2023:10:14", 7: (IFDRational(20), IFDRational(0), IFDRational(7, 2))},
    )  # fmt: skip
    assert read_tags(path) == PhotoTags(
        width=64, height=48, taken=datetime(2023, 10, 14, 22, 0, 0, 250_000), whole_seconds=False, offset=timedelta(hours=2),
        gps_utc=datetime(2023, 10, 14, 20, 0, 3, 500_000, tzinfo=UTC), exposure_s=2.5, focal_length_mm=24.0,
        focal_length_35mm=36.0, focal_plane_px_mm=600.0, tagged_width_px=128, orientation=1 if suffix == "tif" else 6,
        camera="Sky 1", lens="24mm F2[2J",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("base", "photo", "gps"),
    [
        ({}, {}, {}),
        ({0x0112: 99}, {0x9003: "2023:02:30 22:00:00", 0x829A: IFDRational(1, 0), 0x920A: IFDRational(0, 1)}, {}),
        ({}, {0x9003: "yesterday", 0x9011: "+99:00", 0xA405: "wide"}, {29: "2023:10:14", 7: (25, 0, 0)}),
        ({}, {0x9003: b"\xff\xfe", 0x9011: "CET"}, {29: "2023:10:14", 7: (IFDRational(1, 0), 0, 0)}),
        # A clock whose battery is dead, an hour of 75 minutes, a second of three years, a receiver that never had a fix.
        ({}, {0x9003: "0001:01:01 00:00:00", 0x9011: "+02:75"}, {29: "0001:01:01", 7: (0, 0, 0)}),
        ({}, {0x9003: "9999:12:31 23:59:59", 0x829A: IFDRational(100_000_000, 1)}, {}),
    ],
)
def test_faulty_tags_count_as_absent(tmp_path, base, photo, gps) -> None:
    assert read_tags(photograph(tmp_path / "p.jpg", base, photo, gps)) == PhotoTags(64, 48)


def test_no_photograph(tmp_path) -> None:
    (tmp_path / "p.jpg").write_bytes(b"no image")
    with pytest.raises(ImageError, match="cannot be read"):
        read_tags(tmp_path / "p.jpg")
    with pytest.raises(ImageError, match="orientation 6"):
        read_tags(photograph(tmp_path / "p.tif", {0x0112: 6}))
    for name in ("a.NEF", "a.dng"):
        photograph(tmp_path / "p.tif", {}).rename(tmp_path / name)  # as the preview that raw files begin with
        with pytest.raises(ImageError, match="16-bit TIFF"):
            refuse_raw(name)
        with pytest.raises(ImageError, match="16-bit TIFF"):
            celnav.read_image(tmp_path / name)
    refuse_raw("a.tif")


@pytest.mark.parametrize(
    ("changes", "utc", "zone", "stamp", "middle"),
    [
        ({}, "2020-01-01T00:00:00Z", None, "start", "2020-01-01T00:00:00Z"),
        ({}, None, "+02:00", "start", "2023-10-14T20:00:04Z"),
        ({}, None, "+02:00", "middle", "2023-10-14T20:00:00Z"),
        ({}, None, "+02:00", "end", "2023-10-14T19:59:56Z"),
        ({}, None, "Europe/Berlin", "start", "2023-10-14T20:00:04Z"),
        ({}, None, "-0930", "middle", "2023-10-15T07:30:00Z"),
        ({}, None, "UTC", "middle", "2023-10-14T22:00:00Z"),
        ({"offset": timedelta(hours=1)}, None, None, "middle", "2023-10-14T21:00:00Z"),
        ({"offset": timedelta(hours=1)}, None, "+02:00", "middle", "2023-10-14T20:00:00Z"),
        ({"exposure_s": 0.5, "taken": TAKEN + timedelta(seconds=0.25)}, None, "Z", "start", "2023-10-14T22:00:00.5Z"),
        # The clock is right, the zone follows from the time of a position fix one minute old.
        ({"gps_utc": datetime(2023, 10, 14, 16, 14, 0, tzinfo=UTC)}, None, None, "middle", "2023-10-14T16:15:00Z"),
        ({"taken": None, "gps_utc": datetime(2023, 1, 14, 16, 14, tzinfo=UTC)}, None, None, "end", "2023-01-14T16:13:56Z"),
    ],
)  # fmt: skip
def test_middle_of_the_exposure(changes, utc, zone, stamp, middle) -> None:
    found = exposure_time(replace(TAGS, **changes), utc, zone, stamp)
    assert found.utc == middle
    assert bool(found.assumed) == (utc is None)


def test_what_a_tagged_time_marks_says_nothing_of_a_told_one() -> None:
    with pytest.raises(TimeError, match="--exif-time-is, not both"):
        exposure_time(TAGS, "2020-01-01T00:00:00Z", None, "end")


@pytest.mark.parametrize(
    ("changes", "utc", "zone", "message"),
    [
        ({}, None, None, "give --time-zone"),
        ({"taken": None}, None, "+02:00", "give --utc"),
        ({}, "2020-01-01T00:00:00Z", "+02:00", "not both"),
        ({}, "2020-01-01T00:00:00", None, "zone"),
        ({}, None, "+25:00", "not known"),
        ({}, None, "Middle-earth/Shire", "not known"),
        ({}, None, "../../etc/passwd", "not known"),
        ({}, None, "", "not known"),
        ({"gps_utc": datetime(2023, 10, 14, 16, 7, tzinfo=UTC)}, None, None, "give --time-zone"),
        ({"gps_utc": datetime(2023, 10, 10, 16, 0, tzinfo=UTC)}, None, None, "give --time-zone"),
        # A fix a quarter of an hour old: nobody's zone is 2 h 15 min ahead of UTC.
        ({"gps_utc": datetime(2023, 10, 14, 19, 45, tzinfo=UTC)}, None, None, "give --time-zone"),
        ({"taken": datetime(2023, 10, 29, 2, 30)}, None, "Europe/Berlin", r"\+02:00 or \+01:00"),
        ({"taken": datetime(2023, 3, 26, 2, 30)}, None, "Europe/Berlin", r"\+01:00 or \+02:00"),
    ],
)
def test_a_time_that_is_not_known_is_refused(changes, utc, zone, message) -> None:
    with pytest.raises(TimeError, match=message):
        exposure_time(replace(TAGS, **changes), utc, zone)


@pytest.mark.parametrize(
    ("changes", "options", "f_px"),
    [
        ({}, {}, 24 / math.hypot(36, 24) * math.hypot(6000, 4000)),
        ({"width": 1500, "height": 1000}, {}, 1000.0),
        ({"focal_plane_px_mm": 6000 / 35.9}, {}, 24 * 6000 / 35.9),
        (
            {"focal_plane_px_mm": 6000 / 35.9, "tagged_width_px": 6000, "width": 1500, "height": 1000},
            {},
            24 * 1500 / 35.9,
        ),
        # Turned by a program that left the tags alone.
        (
            {"focal_plane_px_mm": 6000 / 35.9, "tagged_width_px": 6000, "width": 4000, "height": 6000},
            {},
            24 * 6000 / 35.9,
        ),
        # The pitch contradicts the field of view: the tag is not of this picture.
        ({"focal_plane_px_mm": 300.0}, {}, 4000.0),
        ({}, {"sensor_width_mm": 23.5}, 24 / 23.5 * 6000),
        ({}, {"sensor_width_mm": 36.0, "focal_length_mm": 50.0}, 50 / 36 * 6000),
        ({"focal_length_mm": None}, {}, 4000.0),
    ],
)
def test_focal_length(changes, options, f_px) -> None:
    found = photo_camera(replace(TAGS, **changes), **options)
    assert found.camera.model == "pinhole"
    assert found.camera.f_px == pytest.approx(f_px, rel=1e-12)
    assert f"{f_px:.0f} px" in found.assumed[0]


def test_wide_lenses_are_warned_of() -> None:
    assert photo_camera(TAGS).warnings == ()
    assert "wide" in photo_camera(replace(TAGS, focal_length_35mm=14.0)).warnings[0]
    assert "fisheye" in photo_camera(replace(TAGS, lens="8mm Fisheye")).warnings[0]


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"focal_length_35mm": None}, {}, "--sensor-width-mm"),
        ({"focal_length_35mm": None, "focal_length_mm": None}, {}, "--camera FILE"),
        ({}, {"focal_length_mm": 50.0}, "--sensor-width-mm"),
        ({"focal_length_mm": None}, {"sensor_width_mm": 36.0}, "--focal-length-mm"),
        ({}, {"sensor_width_mm": -1.0}, "positive"),
        ({}, {"focal_length_mm": math.nan}, "positive"),
    ],
)
def test_a_camera_that_is_not_known_is_refused(changes, options, message) -> None:
    with pytest.raises(CameraError, match=message):
        photo_camera(replace(TAGS, **changes), **options)


def test_a_cropped_picture_has_a_remedy() -> None:
    seen = Detections(np.arange(24.0).reshape(12, 2), np.ones(12), (48, 64), None)
    nothing = Fix.refusal(Reason.NO_HYPOTHESIS, "none")
    camera = photo_camera(TAGS).camera
    by_tags, by_file = (_Lens(camera, "", False, (), of_tags=by) for by in (True, False))
    assert "none; if the picture was cropped" in _with_hint_of_other_lens(nothing, by_tags, seen).message
    assert "--camera unknown" in _with_hint_of_other_lens(nothing, by_tags, seen).message
    assert _with_hint_of_other_lens(nothing, by_file, seen) is nothing
    few = Fix.refusal(Reason.TOO_FEW_DETECTIONS, "few")
    assert _with_hint_of_other_lens(few, by_tags, seen) is few
    mirrored = Fix.refusal(Reason.NO_HYPOTHESIS, f"none; {MIRRORED}")
    assert _with_hint_of_other_lens(mirrored, by_tags, seen) is mirrored


def test_only_the_accelerometers_vertical_is_said_to_be_one() -> None:
    attitude = Attitude.up([0.0, 0.0, 1.0], 0.6)
    assert "accelerometer" in _of_attitude("exif, tilt_sigma=0.6", attitude, TAGS)[0]
    assert _of_attitude("exif_mount.json", attitude, TAGS) == []


@pytest.mark.parametrize(
    ("taken", "exposure_s", "stamp", "expected"),
    [
        (datetime(2023, 10, 29, 3, 0, 10), 60.0, "end", "2023-10-29T01:59:40Z"),
        (datetime(2023, 3, 26, 3, 0, 10), 60.0, "end", "2023-03-26T00:59:40Z"),
        (datetime(2023, 3, 26, 1, 30), 14400.0, "start", "2023-03-26T02:30:00Z"),
        (datetime(2023, 10, 29, 1, 30), 14400.0, "start", "2023-10-29T01:30:00Z"),
    ],
)
def test_exposures_across_a_change_of_summer_time(taken, exposure_s, stamp, expected) -> None:
    """In Berlin summer time begins and ends at 01:00 UTC: a photograph was an hour, and so 15 degrees of longitude, off."""
    tags = replace(TAGS, taken=taken, exposure_s=exposure_s, offset=None)
    assert exposure_time(tags, None, "Europe/Berlin", stamp).utc == expected
