"""Landscapes of OpenEXR pictures: the same light as the same picture in sRGB, bright lamps kept, other files refused."""

import numpy as np
import OpenEXR
import pytest
import yaml
from PIL import Image
from small_scenes import BASE

from generator.errors import ScenarioError
from generator.ground.linear_picture import MOST_TEXELS, read_linear
from generator.ground.panorama import linear
from generator.ground.picture import PictureError
from generator.scenario.file import parse_scenario
from generator.scenario.ground.landscape_spec import landscape_panorama

HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def write_exr(path, channels, **header) -> None:
    arrays = {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}
    OpenEXR.File(HEADER | header, arrays).write(str(path))


def landscape_of(folder, **landscape):
    tree = BASE | {"foreground": {"landscape": landscape}}
    spec = parse_scenario(yaml.safe_dump(tree), str(folder / "scene.yaml")).frame(0).foreground.landscape
    assert spec is not None
    return landscape_panorama(spec, 0)


def test_it_is_the_picture_in_srgb(tmp_path) -> None:
    """A picture in sRGB, and its linear values times alpha: the same reflectances within half a step, the same alpha."""
    rgba = np.random.default_rng(3).integers(0, 256, (40, 80, 4), dtype=np.uint8)
    rgba[rgba[..., 3] < 30] = 0
    Image.fromarray(rgba).save(tmp_path / "plain.png")
    alpha = rgba[..., 3] / 255
    colours = linear(rgba[..., :3]) * alpha[..., None]
    write_exr(tmp_path / "linear.exr", dict(zip("RGBA", [*np.moveaxis(colours, -1, 0), alpha], strict=True)))
    plain, exact = landscape_of(tmp_path, file="plain.png"), landscape_of(tmp_path, file="linear.exr")
    np.testing.assert_array_equal(plain.alpha, exact.alpha)
    assert np.abs(plain.colour.astype(int) - exact.colour)[plain.alpha > 0].max() <= 1
    assert exact.white_reflectance == 1


def test_values_beyond_one(tmp_path) -> None:
    """A picture of light by day: with a reflectance of 0.2, a value of 3 reflects 0.6, 40 reflects all of it. A lamp 500
    times as bright as the glow's white stays so."""
    values = np.full((8, 16), 3.0)
    values[6] = 40.0
    values[7] = 0.5
    write_exr(tmp_path / "day.exr", {"Y": values})
    light = np.full((8, 16), 0.5)
    light[4, 4] = 500.0
    write_exr(tmp_path / "lamp.exr", {"R": light, "G": light, "B": light})
    found = landscape_of(tmp_path, file="day.exr", reflectance=0.2, glow_file="lamp.exr", glow_cd_m2=4.0)
    assert found.glow is not None
    reflectance = linear(found.colour[:, 0, 0]) * found.white_reflectance
    np.testing.assert_allclose(reflectance[[0, 6, 7]], [0.6, 1.0, 0.1], rtol=0.01)
    shine = linear(found.glow[4, [4, 8], 1]) * found.glow_cd_m2
    np.testing.assert_allclose(shine, [2000.0, 2.0], rtol=0.2)
    assert (found.alpha == 255).all()


def refused(tmp_path, message) -> None:
    with pytest.raises(PictureError, match=message) as caught:
        read_linear(tmp_path / "odd.exr", "odd.exr", 1.0)
    assert "odd.exr" in str(caught.value)


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ({"R": np.ones((4, 8)), "G": np.ones((4, 8))}, "channels G, R"),
        ({"Y": -np.ones((4, 8))}, "negative"),
        ({"Y": np.full((4, 8), np.nan)}, "not finite"),
        ({"Y": np.ones((1, 8))}, "too few"),
        ({f"Y{k}" if k else "Y": np.ones((4, 8)) for k in range(5)}, "channels"),
    ],
)
def test_refused_pictures(tmp_path, channels, message) -> None:
    write_exr(tmp_path / "odd.exr", channels)
    refused(tmp_path, message)


def test_damaged_cropped_and_large_files(tmp_path) -> None:
    """The size in the header is judged before pixels are decoded."""
    path = tmp_path / "odd.exr"
    write_exr(path, {"Y": np.ones((64, 64))})
    whole = path.read_bytes()
    at = whole.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    wide = np.array([0, 0, MOST_TEXELS, 63], "<i4").tobytes()
    path.write_bytes(whole[:at] + wide + whole[at + 16 :])
    refused(tmp_path, "at most|cannot be read")
    path.write_bytes(whole[:at] + np.array([0, 0, 31, 63], "<i4").tobytes() + whole[at + 16 :])
    refused(tmp_path, "display window")
    for data in (b"", b"v/1\x01" + b"\xff" * 500, whole[:200], whole[:-200]):
        path.write_bytes(data)
        refused(tmp_path, "cannot be read")


def test_a_scenario_names_the_key(tmp_path) -> None:
    (tmp_path / "odd.exr").write_bytes(b"nothing")
    with pytest.raises(ScenarioError, match=r"foreground\.landscape.*'odd\.exr' cannot be read as OpenEXR"):
        landscape_of(tmp_path, file="odd.exr")
