"""FITS images in compressed tiles: those of every algorithm are read, those that unpack to more than a tile are not."""

from __future__ import annotations

import gzip
import io
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from celnav.errors import ImageError
from celnav.reading import fits_file
from celnav.reading.fits_file import read_fits

PIXELS = np.arange(64 * 48, dtype=np.int16).reshape(48, 64)
BOMB_BYTES = 100_000_000


@pytest.mark.parametrize("algorithm", ["GZIP_1", "GZIP_2", "RICE_1", "PLIO_1", "HCOMPRESS_1", "NOCOMPRESS"])
@pytest.mark.parametrize("tile", [(16, 64), (20, 50)])
def test_tiles_of_every_algorithm_are_read(tmp_path, algorithm, tile) -> None:
    fits.CompImageHDU(PIXELS, compression_type=algorithm, tile_shape=tile).writeto(tmp_path / "a.fits")
    assert (read_fits(tmp_path / "a.fits").pixels == PIXELS).all()


@pytest.mark.parametrize("quantize_level", [0.0, 16.0])
def test_tiles_of_floating_numbers_are_read(tmp_path, quantize_level) -> None:
    """Without steps as GZIP, with steps as Rice; of equal values as GZIP beside it."""
    values = np.random.default_rng(1).normal(size=(48, 64)).astype(np.float32)
    values[:8] = 5
    unit = fits.CompImageHDU(values, compression_type="GZIP_1" if quantize_level == 0 else "RICE_1",
                             quantize_level=quantize_level)  # fmt: skip
    unit.writeto(tmp_path / "a.fits")
    assert np.allclose(read_fits(tmp_path / "a.fits").pixels, values, atol=0.1)


def hostile(path: Path, stream: bytes, **header: object) -> Path:
    """An image of one tile, whose stream is replaced; words of the header too."""
    made = io.BytesIO()
    fits.CompImageHDU(np.zeros((64, 64), np.int16), compression_type="GZIP_1", tile_shape=(64, 64)).writeto(made)
    with fits.open(io.BytesIO(made.getvalue()), disable_image_compression=True) as units:
        primary, words = units[0].header, units[1].header.copy()
    words.update({"PCOUNT": len(stream), "TFORM1": f"1PB({len(stream)})"} | header)
    size = words.pop("SIZE", len(stream))
    row = np.array([size, words.pop("OFFSET", 0)], ">i4").tobytes().ljust(words["NAXIS1"], b"\0")
    data = row * words["NAXIS2"] + stream
    path.write_bytes(primary.tostring().encode() + words.tostring().encode() + data + bytes(-len(data) % 2880))
    return path


@pytest.mark.parametrize("in_parts", [False, True])
def test_a_tile_that_unpacks_to_more_than_a_tile_is_refused_before(tmp_path, in_parts, monkeypatch) -> None:
    monkeypatch.setattr(fits_file, "MAX_BYTES", 10**6)
    parts = 4 if in_parts else 1
    path = hostile(tmp_path / "bomb.fits", gzip.compress(bytes(BOMB_BYTES // parts), 9) * parts)
    assert path.stat().st_size < 200_000
    tracemalloc.start()
    with pytest.raises(ImageError, match=r"bomb\.fits has a compressed tile of more than the 32768 bytes"):
        read_fits(path)
    assert tracemalloc.get_traced_memory()[1] < BOMB_BYTES // 4
    tracemalloc.stop()


def test_a_bomb_beside_the_tiles_of_another_algorithm_is_refused(tmp_path) -> None:
    path = hostile(tmp_path / "bomb.fits", gzip.compress(bytes(10**6)), ZCMPTYPE="RICE_1",
                   TTYPE1="GZIP_COMPRESSED_DATA")  # fmt: skip
    with pytest.raises(ImageError, match="a compressed tile of more than"):
        read_fits(path)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"ZTILE1": 0}, "compressed tiles without a size"),
        ({"SIZE": -1}, "lies outside the file"),
        ({"OFFSET": -100}, "lies outside the file"),
        ({"SIZE": 10**8}, "lies outside the file"),
        ({"ZTILE1": 1, "ZTILE2": 1, "NAXIS2": 4096}, "lie over each other"),
    ],
)
def test_tables_of_tiles_that_cannot_be_are_refused(tmp_path, header, words) -> None:
    path = hostile(tmp_path / "a.fits", gzip.compress(b"ab").ljust(5000, b"\0"), **header)
    with pytest.raises(ImageError, match=words):
        read_fits(path)


def test_more_tiles_than_any_image_has_are_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(fits_file, "_MOST_TILES", 40)
    fits.CompImageHDU(PIXELS).writeto(tmp_path / "a.fits")
    with pytest.raises(ImageError, match="has 48 compressed tiles; the limit is 40"):
        read_fits(tmp_path / "a.fits")
