"""JPEG pictures whose scans are repeated, each a pass over all pixels."""

import io

import numpy as np
import pytest
from PIL import Image

from celnav.errors import ImageError
from celnav.reading.image_file import read_image


def picture(**options: object) -> bytes:
    made = io.BytesIO()
    noise = np.random.default_rng(1).integers(0, 255, (64, 80, 3), dtype=np.uint8)
    Image.fromarray(noise).save(made, "JPEG", **options)
    return made.getvalue()


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"quality": 100, "comment": b"\xff\xda" * 300}])
def test_pictures_as_programs_write_them_are_read(tmp_path, options) -> None:
    # What follows a picture, as a telephone's film does, is none of its scans.
    (tmp_path / "a.jpg").write_bytes(picture(**options) + b"\xff\xda" * 300)
    assert read_image(tmp_path / "a.jpg").shape == (64, 80, 3)


def test_a_picture_of_hundreds_of_scans_is_refused(tmp_path, monkeypatch) -> None:
    data = picture(progressive=True)
    last = data.rindex(b"\xff\xda")
    (tmp_path / "a.jpg").write_bytes(data[:last] + data[last:-2] * 200 + b"\xff\xd9")
    monkeypatch.setattr(Image.Image, "load", lambda image: pytest.fail("the picture was decoded"))
    with pytest.raises(ImageError, match=r"a\.jpg has more than 100 scans: save it anew"):
        read_image(tmp_path / "a.jpg")


def test_a_file_of_several_pictures_is_no_way_around_the_limit(tmp_path, monkeypatch) -> None:
    made = io.BytesIO()
    grey = Image.fromarray(np.random.default_rng(1).integers(0, 255, (64, 80), dtype=np.uint8))
    grey.save(made, "MPO", save_all=True, append_images=[grey], progressive=True)
    data = made.getvalue()
    end = data.index(b"\xff\xd9\xff\xd8")
    last = data.rindex(b"\xff\xda", 0, end)
    (tmp_path / "a.jpg").write_bytes(data[:end] + data[last:end] * 200 + data[end:])
    with Image.open(tmp_path / "a.jpg") as image:
        assert image.format == "MPO"
    monkeypatch.setattr(Image.Image, "load", lambda image: pytest.fail("the picture was decoded"))
    with pytest.raises(ImageError, match=r"a\.jpg has more than 100 scans: save it anew"):
        read_image(tmp_path / "a.jpg")


@pytest.mark.parametrize("filler", [b"\xff" * 200_000, b"\xff\x01" * 50_000])
def test_fillers_neither_cost_time_nor_hide_scans(tmp_path, filler) -> None:
    """Runs of 0xFF, in which a search may begin anew at each byte, and markers without a length before the scans."""
    data = picture(progressive=True)
    last = data.rindex(b"\xff\xda")
    (tmp_path / "a.jpg").write_bytes(data[:last] + filler + data[last:-2] * 200 + b"\xff\xd9")
    with pytest.raises(ImageError, match=r"a\.jpg has more than 100 scans: save it anew"):
        read_image(tmp_path / "a.jpg")


def test_a_picture_of_endless_segments_is_refused(tmp_path) -> None:
    data = picture()
    (tmp_path / "a.jpg").write_bytes(data[:2] + b"\xff\xfe\x00\x02" * 30_000 + data[2:])
    with pytest.raises(ImageError, match=r"a\.jpg has more than 20000 segments: save it anew"):
        read_image(tmp_path / "a.jpg")
