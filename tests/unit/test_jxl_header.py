"""The size of a JPEG XL image is read from its header, and bounds what is unpacked."""

from __future__ import annotations

import imagecodecs
import numpy as np
import pytest

from generator.dataset.images import decode, encode
from generator.dataset.reader import decode_member
from generator.errors import GeneratorError
from generator.reading.jxl_header import CODESTREAM, CONTAINER, jxl_shape

# Every form of the header: one side or both in eights of pixels, each of the seven ratios, 9 and 13 bits.
SHAPES = ((1, 1), (8, 8), (8, 16), (256, 264), (257, 1), (48, 64), (100, 120), (9, 12), (100, 150), (90, 160), (100, 125),
          (100, 200), (513, 9000), (9000, 300))  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
def test_the_size_is_the_one_that_libjxl_wrote(shape) -> None:
    image = np.arange(shape[0] * shape[1], dtype=np.uint32).astype(np.uint16).reshape(shape)
    data = encode(image, "jxl")
    assert data.startswith(CONTAINER)
    assert jxl_shape(data) == shape
    np.testing.assert_array_equal(decode_member("jxl", data), image)
    bare = bytes(imagecodecs.jpegxl_encode(image.astype(np.uint8), effort=1))
    assert bare.startswith(CODESTREAM)
    assert jxl_shape(bare) == shape


def claim(side: int) -> bytes:
    """A header that claims a square image: not in eights, 30 bits of height, ratio 1."""
    return CODESTREAM + (0 | 3 << 1 | (side - 1) << 3 | 1 << 33).to_bytes(10, "little")


def test_a_claimed_size_bounds_what_is_unpacked() -> None:
    assert jxl_shape(claim(30_000)) == (30_000, 30_000)
    with pytest.raises(GeneratorError, match="a JPEG XL of 1073741824 x 1073741824 pixels, more than 16384 a side"):
        decode_member("jxl", claim(2**30))
    strip = encode(np.zeros((1, 20_000), np.uint16), "jxl")
    with pytest.raises(GeneratorError, match="a JPEG XL of 20000 x 1 pixels, more than 16384 a side"):
        decode(strip, "jxl")


@pytest.mark.parametrize("form", [(40, 30, 3), (5, 40, 30)])
def test_colours_and_films_are_refused(form) -> None:
    photometric = "rgb" if form[2] == 3 else None
    data = bytes(imagecodecs.jpegxl_encode(np.zeros(form, np.uint16), lossless=True, photometric=photometric))
    with pytest.raises(GeneratorError, match="not a JPEG XL image"):
        decode_member("jxl", data)


@pytest.mark.parametrize(
    "data", [b"", CODESTREAM, CONTAINER, CONTAINER + b"\0" * 40, CONTAINER + b"\xff" * 40, b"\x89PNG"]
)
def test_what_is_no_image_is_refused(data) -> None:
    with pytest.raises(GeneratorError, match="not a JPEG XL image"):
        decode_member("jxl", data)
