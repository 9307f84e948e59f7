"""HEIF photographs: pixels and tags through both readers, hostile files, and the remedy where the package is missing."""

import io
import subprocess
import sys

import numpy as np
import pillow_heif
import pytest
import yaml
from PIL import Image
from small_scenes import BASE, small_scenario

from celnav.command.exif import read_tags
from celnav.command.exposure_time import exposure_time
from celnav.command.photo_camera import photo_camera
from celnav.errors import ImageError
from celnav.reading import heif_file
from celnav.reading.image_file import read_image
from generator.dataset.generate import generate
from generator.dataset.images import photo
from generator.dataset.layout import DatasetSpec
from generator.dataset.reader import Dataset
from generator.dataset.verify import problems
from generator.errors import GeneratorError
from generator.frame.render import render_dataset, render_frame
from generator.scenario.file import parse_scenario

PHOTO = {"format": "heif", "quality": 95, "subsampling": "4:4:4", "utc_offset": "+01:00", "camera": "Sky 1"}
CAMERA = {"camera__hfov_deg": 70, "camera__pixel_pitch_um": 5.0}


def scenario(**photo_values):
    sensor = {"colour": {}, "develop": {"exposure": 4.0, "photo": PHOTO | photo_values}}
    return small_scenario(sensor=sensor, time__utc_start="2020-01-15T20:00:00.123456Z", **CAMERA)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pixels_are_those_of_the_developed_picture_whatever_the_orientation(tmp_path, orientation) -> None:
    """The reader turns them back; celnav's pixels are those that any decoder shows, here turned by Pillow."""
    frame = render_frame(scenario(orientation=orientation), 0)
    data = frame.attached["photo.heic"]
    stored = photo(data, (180, 270))
    assert np.sqrt(np.mean((stored.astype(float) - frame.developed) ** 2)) < 4
    path = tmp_path / "photo.heic"
    path.write_bytes(data)
    upright = Image.fromarray(stored)
    turns = (None, *(Image.Transpose(code) for code in (0, 3, 1, 5, 4, 6, 2)))
    if orientation > 1:
        upright = upright.transpose(turns[orientation - 1])
    np.testing.assert_array_equal(read_image(path), np.array(upright))


def test_the_same_bytes_again_and_truth_as_of_a_jpeg() -> None:
    frame, again = render_frame(scenario(), 0), render_frame(scenario(), 0)
    other = render_frame(scenario(format="jpeg"), 0)
    assert frame.attached == again.attached
    assert frame.stars.equals(other.stars)
    np.testing.assert_array_equal(frame.dn, other.dn)


def test_a_grey_sensor_gives_a_grey_picture(tmp_path) -> None:
    frame = render_frame(small_scenario(sensor={"develop": {"photo": {"format": "heif", "quality": 95}}}), 0)
    path = tmp_path / "photo.heic"
    path.write_bytes(frame.attached["photo.heic"])
    assert read_image(path).shape == frame.developed.shape == photo(path.read_bytes()).shape
    assert np.sqrt(np.mean((read_image(path).astype(float) - frame.developed) ** 2)) < 3


def test_the_solver_finds_time_and_camera_in_the_tags(tmp_path) -> None:
    frame = render_frame(scenario(orientation=6), 0)
    path = tmp_path / "photo.heic"
    path.write_bytes(frame.attached["photo.heic"])
    found = read_tags(path)
    assert (found.camera, found.orientation, found.exposure_s) == ("Sky 1", 1, 0.5)
    assert (found.width, found.height) == (180, 270)
    assert exposure_time(found, None, None).utc == frame.plan.utc_mid.isoformat()
    camera = photo_camera(found).camera
    assert camera.f_px == pytest.approx(frame.plan.spec.camera.f_px, rel=1e-4)
    assert (camera.width, camera.height) == (180, 270)


def test_ten_bits_and_transparency_are_read(tmp_path) -> None:
    """Values of 10 bits as 16, alpha left out."""
    deep = (np.random.default_rng(0).integers(0, 1024, (64, 96)) * 64).astype(np.uint16)
    path = tmp_path / "deep.heic"
    pillow_heif.encode("I;16", (96, 64), deep.tobytes(), path, quality=-1)
    pixels = read_image(path)
    assert (pixels.dtype, pixels.shape) == (np.uint16, (64, 96))
    assert abs(pixels.astype(int) - deep).max() <= 64
    see_through = Image.fromarray(np.full((64, 96, 4), 128, np.uint8))
    pillow_heif.from_pillow(see_through).save(tmp_path / "alpha.heic", quality=-1)
    assert read_image(tmp_path / "alpha.heic").shape == (64, 96, 3)


def test_damaged_large_and_strange_files_are_refused(tmp_path, monkeypatch) -> None:
    data = render_frame(scenario(), 0).attached["photo.heic"]
    for content in (data[:300], data[: len(data) // 2], data[:12] + bytes(400)):
        path = tmp_path / "damaged.heic"
        path.write_bytes(content)
        with pytest.raises(ImageError, match="damaged"):
            read_image(path)
        with pytest.raises(GeneratorError, match="damaged HEIF"):
            photo(content, (180, 270))
    with pytest.raises(GeneratorError, match="270 x 180 pixels"):
        photo(data, (180, 271))
    path.write_bytes(data)
    monkeypatch.setattr("celnav.reading.image_file.MAX_PIXELS", 1000)
    monkeypatch.setattr(heif_file, "decode", lambda *_: pytest.fail("decoded before its size was judged"))
    with pytest.raises(ImageError, match="limit is 100 million"):
        read_image(path)
    monkeypatch.setattr(heif_file, "MAX_BYTES", 1000)
    with pytest.raises(ImageError, match="the limit of a HEIF picture"):
        read_tags(path)


def test_a_dataset_holds_and_checks_them(tmp_path) -> None:
    text = yaml.safe_dump(BASE | {"sensor": {"colour": {}, "develop": {"photo": PHOTO | {"orientation": 8}}}})
    generate(parse_scenario(text, "test"), text, tmp_path / "set", DatasetSpec(shard_size=1))
    frame = Dataset.open(tmp_path / "set")[0]
    assert frame.photo.shape == (180, 270, 3)
    assert problems(tmp_path / "set") == []


def test_a_scenario_of_heif_photographs_is_refused_at_once_without_the_package(monkeypatch, tmp_path) -> None:
    wanted = scenario()
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    for make in (
        lambda: generate(wanted, "", tmp_path / "set", DatasetSpec()),
        lambda: render_dataset(wanted, tmp_path / "frames"),
    ):
        with pytest.raises(GeneratorError, match=r"pip install 'skybench\[heif\]'"):
            make()
    assert not list(tmp_path.iterdir())


def test_the_remedy_is_named_where_the_package_is_missing(tmp_path) -> None:
    path = tmp_path / "photo.heic"
    buffer = io.BytesIO()
    pillow_heif.from_pillow(Image.new("L", (64, 64))).save(buffer)
    path.write_bytes(buffer.getvalue())
    code = f"""
import sys
sys.modules["pillow_heif"] = None
from celnav.reading.image_file import read_image
from generator.dataset.images import photo
for read in (lambda: read_image({str(path)!r}), lambda: photo(open({str(path)!r}, "rb").read())):
    try:
        read()
    except Exception as error:
        print(type(error).__name__, error)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, second = run.stdout.splitlines()
    assert first.startswith("ImageError")
    assert second.startswith("GeneratorError")
    assert "pip install 'skybench[heif]'" in first
    assert "pip install 'skybench[heif]'" in second
