"""Pictures of 16 bits, PNG and TIFF, imported by the command: values, size, and the time and place that options state."""

import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import tifffile
from numpy.typing import NDArray
from photograph_files import CAMERA, EXPOSURE_S, PLACE, UTC_MID, WANDER_DEG, standin, write_camera
from PIL import Image
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.frames.dataset import open_dataset

SITE = ["--site", "52.0", "4.36", "10"]


def grey() -> NDArray[np.uint16]:
    """A sky of 3,200 DN with all sixteen bits in use: the brightest star is full, and the lowest bits are noise."""
    low_bits = np.random.default_rng(4).integers(0, 8, (CAMERA.height, CAMERA.width))
    return np.clip(8 * standin().astype(np.int64) + low_bits, 0, 65535).astype(np.uint16)


def colours() -> NDArray[np.uint16]:
    """Red, green and blue of one sky, which differ in every pixel and add up to less than 65,536."""
    sky = grey()
    return np.stack([sky // 3, sky // 4, sky // 7], axis=2)


def write_picture(path: Path, values: NDArray[np.uint16]) -> None:
    """Write a picture by another library than the one that reads it."""
    if path.suffix == ".png":
        assert cv2.imwrite(str(path), values if values.ndim == 2 else values[:, :, ::-1])
    else:
        tifffile.imwrite(path, values, photometric="minisblack" if values.ndim == 2 else "rgb", metadata=None)


def imported(folder: Path, *options: str) -> tuple[dict, Path]:
    """What the command prints for a folder of photographs, and the dataset that it makes."""
    camera, out = write_camera(folder.parent / "camera.json"), folder.parent / "out"
    words = ["import", "photos", str(folder), *SITE, "--camera", str(camera), "--out", str(out), "--json", *options]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout), out


@pytest.mark.parametrize("values", [grey(), colours()], ids=["grey", "colour"])
@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_pictures_of_16_bits_keep_their_values(tmp_path: Path, name: str, values: NDArray[np.uint16]) -> None:
    photos, times = tmp_path / "photos", tmp_path / "times.csv"
    photos.mkdir()
    write_picture(photos / name, values)
    times.write_text(f"file,utc_mid,exposure_s\n{name},{UTC_MID},{EXPOSURE_S}\n", encoding="utf-8")
    told, out = imported(photos, "--times", str(times))
    (made,) = told["made"]
    (frame,) = open_dataset(out).frames
    pixels = np.asarray(Image.open(frame.image_path))
    assert pixels.shape == (CAMERA.height, CAMERA.width)
    assert np.array_equal(pixels, values if values.ndim == 2 else values.sum(axis=2, dtype=np.uint32))
    record = json.loads((out / "frame-00000.json").read_text())
    assert record["sensor"]["bits"] == 16
    assert (record["photograph"]["file"], record["photograph"]["scale"], record["photograph"]["offset_dn"]) == (
        name,
        1,
        0,
    )
    site = record["site"]
    assert (site["latitude_deg"], site["longitude_deg"], site["height_m"]) == (
        PLACE.latitude_deg, PLACE.longitude_deg, PLACE.height_m,
    )  # fmt: skip
    assert record["time"]["exposure_s"] == EXPOSURE_S
    assert np.datetime64(frame.observation.utc.removesuffix("Z")) == np.datetime64(UTC_MID.removesuffix("Z"))
    # The stars stand where this time and this place put them.
    assert made["stars"] > 50
    assert made["turned_deg"] == pytest.approx(WANDER_DEG, abs=0.02)
    stars = pq.read_table(out / "stars.parquet").to_pandas()
    assert stars["saturated"].any() == (values.ndim == 2)  # a third of the light never fills a colour


@pytest.mark.parametrize(
    ("suffix", "stamp", "middle"),
    [(".png", "start", "20:00:02"), (".tif", "end", "19:59:58"), (".tif", "middle", "20:00:00")],
)
def test_clocks_and_exposures_of_pictures_of_16_bits_are_as_the_options_say(
    tmp_path: Path, suffix: str, stamp: str, middle: str
) -> None:
    """The tags state the time of a clock in Oslo, an hour ahead of UTC, and no exposure."""
    photos = tmp_path / "photos"
    photos.mkdir()
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = "2020:01:15 21:00:00"
    Image.fromarray(grey()).save(photos / f"a{suffix}", exif=exif.tobytes())
    options = ("--time-zone", "Europe/Oslo", "--exposure-s", "4", "--stamp", stamp)
    told, out = imported(photos, *options)
    assert told["made"][0]["utc_mid"].startswith(f"2020-01-15T{middle}")
    (frame,) = open_dataset(out).frames
    assert frame.observation.utc.startswith(f"2020-01-15T{middle}")
    assert json.loads((out / "frame-00000.json").read_text())["time"]["exposure_s"] == 4.0
    assert np.array_equal(np.asarray(Image.open(frame.image_path)), grey())
