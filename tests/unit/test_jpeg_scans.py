"""JPEG pictures whose scans or segments are repeated, in landscapes and among the photographs of a dataset."""

import io

import numpy as np
import pytest
from PIL import Image

from generator.dataset.images import photo
from generator.errors import GeneratorError
from generator.ground.picture import PictureError, read_picture
from generator.reading.jpeg_scans import MOST_SEGMENTS, excess

PIXELS = np.random.default_rng(1).integers(0, 255, (64, 80, 3), dtype=np.uint8)
SCAN = b"\xff\xda"


def picture(kind: str = "JPEG", **options: object) -> bytes:
    made = io.BytesIO()
    # A file of several pictures, as telephones write it with depths and previews, is a JPEG with others behind it.
    more = {"save_all": True, "append_images": [Image.fromarray(PIXELS)]} if kind == "MPO" else {}
    Image.fromarray(PIXELS).save(made, kind, **more, **options)
    return made.getvalue()


def with_scans(data: bytes, count: int, between: bytes = b"") -> bytes:
    """The last scan of the first picture, of that many in all."""
    end = data.index(b"\xff\xd9", data.index(SCAN))
    last = data.rindex(SCAN, 0, end)
    return data[:end] + (between + data[last:end]) * (count - data.count(SCAN, 0, end)) + data[end:]


@pytest.mark.parametrize("kind", ["JPEG", "MPO"])
@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"quality": 100, "comment": SCAN * 300}])
def test_pictures_as_programs_write_them_are_read(kind, options) -> None:
    data = picture(kind, **options) + SCAN * 300
    assert photo(data, (64, 80)).shape == (64, 80, 3)
    assert read_picture(data, "a.jpg").shape == (64, 80, 4)


def test_the_limit_itself_is_permitted() -> None:
    data = with_scans(picture(progressive=True), 100)
    assert photo(data, (64, 80)).shape == (64, 80, 3)
    assert read_picture(data, "a.jpg").shape == (64, 80, 4)


@pytest.mark.parametrize("kind", ["JPEG", "MPO"])
@pytest.mark.parametrize("between", [b"", b"\xff\x01", b"\xff\xd0", b"\xff\xfe\x00\x04\xff\xd9"])
def test_one_scan_more_is_refused_before_it_is_decoded(monkeypatch, kind, between) -> None:
    """Also if markers without a length, whose next bytes are none, or comments that hold markers stand between scans."""
    data = with_scans(picture(kind, progressive=True), 101, between)
    monkeypatch.setattr(Image.Image, "load", lambda image: pytest.fail("the picture was decoded"))
    with pytest.raises(GeneratorError, match="a JPEG of more than 100 scans"):
        photo(data, (64, 80))
    with pytest.raises(PictureError, match=r"'a\.jpg' is a JPEG of more than 100 scans, .*: save it anew"):
        read_picture(data, "a.jpg")


def test_a_picture_of_endless_segments_is_refused() -> None:
    data = picture()
    data = data[:2] + b"\xff\xfe\x00\x02" * MOST_SEGMENTS + data[2:]
    with pytest.raises(PictureError, match=rf"'a\.jpg' is a JPEG of more than {MOST_SEGMENTS} segments"):
        read_picture(data, "a.jpg")


@pytest.mark.parametrize("filling", [b"\xff", b"\xff\x00", b"\xff\x01", b"\xff\xd0"])
def test_fillings_are_passed_over(filling) -> None:
    """A search that began anew at each of their bytes would not come to an end."""
    assert excess(b"\xff\xd8" + filling * 2_000_000 + b"\x00") is None
