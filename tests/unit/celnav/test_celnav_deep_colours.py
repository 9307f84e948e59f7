"""Pictures of 16 bits in colours: PNG and TIFF keep their values, and hostile ones stay bounded."""

import struct
import zlib

import numpy as np
import pytest
import tifffile

from benchmark.importing.photographs import Clock, read_photograph
from celnav.errors import ImageError
from celnav.reading.image_file import read_image

DEEP = np.random.default_rng(1).integers(0, 65536, (50, 70, 4), dtype=np.uint16)


def refused(text, call, *args):
    with pytest.raises(ImageError, match=text) as caught:
        call(*args)
    assert "\n" not in str(caught.value)


def deep_png(samples, colour_type, chunks=b"", interlaced=False):
    """A PNG of 16 bits, written by hand."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    # First row and column of each pass of Adam7, and the steps.
    seven = ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1))
    lines = b""
    for y, x, down, right in seven if interlaced else ((0, 0, 1, 1),):
        lines += b"".join(b"\0" + row.astype(">u2").tobytes() for row in samples[y::down, x::right])
    height, width = samples.shape[:2]
    header = struct.pack(">IIBBBBB", width, height, 16, colour_type, 0, 0, int(interlaced))
    parts = chunk(b"IHDR", header) + chunks + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


def test_png_of_16_bits_in_colours_keeps_its_values(tmp_path):
    path = tmp_path / "deep.png"
    clear = struct.pack(">I", 6) + b"tRNS" + struct.pack(">HHH", *DEEP[3, 3, :3].tolist())
    clear += struct.pack(">I", zlib.crc32(clear[4:]))
    colours = DEEP[:, :, :3]
    for data in (
        deep_png(colours, 2), deep_png(DEEP, 6), deep_png(colours, 2, clear), deep_png(colours, 2, interlaced=True)
    ):  # fmt: skip
        path.write_bytes(data)
        found = read_image(path)
        assert found.dtype == np.uint16
        np.testing.assert_array_equal(found, colours)
        path.write_bytes(data[: len(data) // 2])
        refused("damaged", read_image, path)
        spoilt = bytearray(data)
        spoilt[len(data) // 2] ^= 255
        path.write_bytes(spoilt)
        refused("damaged", read_image, path)
    path.write_bytes(deep_png(DEEP[:, :, :2], 4))
    np.testing.assert_array_equal(read_image(path), DEEP[:, :, 0])


@pytest.mark.parametrize(
    "options", [{}, {"planarconfig": "separate"}, {"compression": "lzw"}, {"byteorder": ">"}, {"tile": (16, 16)}]
)
def test_tiff_of_16_bits_in_colours_keeps_its_values(tmp_path, options):
    path, colours = tmp_path / "deep.tif", DEEP[:, :, :3]
    stored = np.moveaxis(colours, 2, 0) if "planarconfig" in options else colours
    tifffile.imwrite(path, stored, photometric="rgb", **options)
    np.testing.assert_array_equal(read_image(path), colours)
    path.write_bytes(path.read_bytes()[:9000])
    refused("damaged|not a PNG", read_image, path)


def test_tiff_of_16_bits_is_turned_as_one_of_8(tmp_path):
    """Pillow turns what it reads by tag 274; what it does not read is turned alike."""
    deep, shallow = tmp_path / "deep.tif", tmp_path / "shallow.tif"
    colours = DEEP[:, :, :3]
    for orientation in range(1, 9):
        tags = [(274, 3, 1, orientation, True)]
        tifffile.imwrite(deep, colours, photometric="rgb", extratags=tags)
        tifffile.imwrite(shallow, (colours >> 8).astype(np.uint8), photometric="rgb", extratags=tags)
        np.testing.assert_array_equal(read_image(deep) >> 8, read_image(shallow))


def test_deep_colours_with_far_more_bytes_than_pixels_are_refused(tmp_path):
    path = tmp_path / "padded.png"
    path.write_bytes(deep_png(DEEP[:, :, :3], 2))
    with path.open("r+b") as stream:
        stream.truncate(70_000_000)
    refused("MB", read_image, path)


def test_import_of_photographs_adds_deep_colours(tmp_path):
    """12 bits in each of three colours are 14 bits of DN."""
    path = tmp_path / "deep.png"
    colours = DEEP[:, :, :3] >> 4
    path.write_bytes(deep_png(colours, 2))
    photograph = read_photograph(path, Clock(table={path.name: ("2020-01-15T20:00:05Z", 10.0)}))
    np.testing.assert_array_equal(photograph.pixels, colours.astype(np.uint32).sum(axis=2))
    assert photograph.bits == 14
