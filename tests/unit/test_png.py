"""The project's own 16-bit PNG encoder, read back by others."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image

from generator.frame.png import png16

RANDOM = np.random.default_rng(1)
PICTURES = {
    "noise": RANDOM.poisson(90, (72, 108)).astype(np.uint16),
    "full range": RANDOM.integers(0, 65536, (33, 17)).astype(np.uint16),
    "flat": np.full((40, 60), 64, np.uint16),
    "a lit corner": np.pad(RANDOM.poisson(90, (12, 18)).astype(np.uint16), [(0, 60), (0, 90)], constant_values=64),
    "one pixel": np.array([[65535]], np.uint16),
    "one row": np.arange(0, 60000, 700, dtype=np.uint16)[None],
    "view of a column": RANDOM.integers(0, 4096, (50, 90)).astype(np.uint16)[:, 3:4],
}


@pytest.mark.parametrize("name", sorted(PICTURES))
def test_pillow_and_opencv_read_the_same_pixels(name) -> None:
    pixels = PICTURES[name]
    data = png16(pixels)
    with Image.open(io.BytesIO(data)) as image:
        image.load()
        np.testing.assert_array_equal(np.array(image, dtype=np.uint16), pixels)
    by_opencv = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert by_opencv.dtype == np.uint16
    np.testing.assert_array_equal(by_opencv, pixels)


def test_noise_and_flat_frames_are_smaller_than_pillow_s_fastest_level() -> None:
    for name in ("noise", "flat", "a lit corner"):
        stream = io.BytesIO()
        Image.fromarray(PICTURES[name]).save(stream, format="PNG", compress_level=1)
        assert len(png16(PICTURES[name])) < len(stream.getvalue()) + 64
