"""JPEG files of more scans than any program writes are refused before they are decoded, under any of the format's names."""

import io

import numpy as np
import pytest
from PIL import Image

from generator.dataset.images import photo
from generator.errors import GeneratorError
from generator.ground.picture import PictureError, read_picture
from generator.reading.jpeg_scans import MOST_SCANS, too_many_scans

START_OF_IMAGE, START_OF_SCAN, END_OF_IMAGE = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"
SIZE = 64


def jpeg(mode: str = "L", **options: object) -> bytes:
    """A progressive picture of noise."""
    grey = np.random.default_rng(1).integers(0, 256, (SIZE, SIZE) if mode == "L" else (SIZE, SIZE, 3), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(grey, mode).save(file, "JPEG", progressive=True, **options)
    return file.getvalue()


def with_scans(data: bytes, more: int) -> bytes:
    """The same picture with its last scan repeated."""
    last = data.rindex(START_OF_SCAN)
    return data[: -len(END_OF_IMAGE)] + more * data[last : -len(END_OF_IMAGE)] + END_OF_IMAGE


def as_multi_picture(data: bytes) -> bytes:
    """The same with a second picture after it and an index of both, under which Pillow has another name for a JPEG."""
    file = io.BytesIO()
    small = Image.new("L", (SIZE, SIZE))
    small.save(file, "MPO", save_all=True, append_images=[small])
    both = file.getvalue()
    second = both.index(END_OF_IMAGE + START_OF_IMAGE) + len(END_OF_IMAGE)
    index = both.index(b"\xff\xe2")
    length = 2 + int.from_bytes(both[index + 2 : index + 4], "big")
    return START_OF_IMAGE + both[index : index + length] + data[len(START_OF_IMAGE) :] + both[second:]


@pytest.mark.parametrize("kind", ["L", "RGB"])
def test_pictures_as_programs_write_them_are_few_scans(kind) -> None:
    data = jpeg(kind, comment=START_OF_SCAN * 200)
    assert not too_many_scans(data)
    assert not too_many_scans(data[: len(data) // 2])
    assert not too_many_scans(b"no picture")
    assert photo(data, (SIZE, SIZE)).shape[:2] == read_picture(data, "a.jpg").shape[:2] == (SIZE, SIZE)


@pytest.mark.parametrize("dressed", [bytes, as_multi_picture])
def test_a_bomb_of_scans_is_refused_by_every_reader(dressed) -> None:
    allowed, bomb = (dressed(with_scans(jpeg(), more)) for more in (MOST_SCANS // 2, MOST_SCANS))
    with Image.open(io.BytesIO(bomb)) as image:
        assert image.format == ("JPEG" if dressed is bytes else "MPO")
    assert (too_many_scans(allowed), too_many_scans(bomb)) == (False, True)
    assert read_picture(allowed, "a.jpg").shape == (SIZE, SIZE, 4)
    with pytest.raises(PictureError, match=f"'a.jpg' has more than {MOST_SCANS} scans: save it anew"):
        read_picture(bomb, "a.jpg")
    with pytest.raises(GeneratorError, match=f"a JPEG of more than {MOST_SCANS} scans"):
        photo(bomb, (SIZE, SIZE))
