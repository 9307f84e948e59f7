"""Files beside a scenario as a stranger could forge them: refused with the key and a reason, before they are decoded."""

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import yaml
from PIL import Image
from small_scenes import BASE

from generator.errors import ScenarioError
from generator.ground.linear_picture import read_linear
from generator.ground.stellarium.landscape import read_landscape
from generator.ground.stellarium.package import PackageError
from generator.scenario.file import load_scenario

INI = "[landscape]\nname = x\ntype = spherical\nmaptex = a.png\n"


def part(name: str, side: int, channels: str) -> OpenEXR.Part:
    pixels = np.ones((side, side), np.float32)
    return OpenEXR.Part({"compression": OpenEXR.ZIP_COMPRESSION}, {key: pixels.copy() for key in channels}, name)


def parts(*made: OpenEXR.Part) -> Callable[[Path], None]:
    return lambda path: OpenEXR.File(list(made)).write(str(path))


def fits_header(*cards: str) -> Callable[[Path], None]:
    first = ("SIMPLE  =                    T", "BITPIX  =                    8")
    text = "".join(card.ljust(80) for card in (*first, *cards, "END"))
    return lambda path: path.write_bytes(text.ljust(2880).encode() + bytes(2880))


def damaged_lzma(path: Path) -> None:
    """A package whose list of members is whole, and the settings of its first member are not."""
    picture = io.BytesIO()
    Image.new("RGBA", (64, 32)).save(picture, "PNG")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("x/landscape.ini", INI + "#" * 3000, compress_type=zipfile.ZIP_LZMA)
        archive.writestr("x/a.png", picture.getvalue())
    data = bytearray(path.read_bytes())
    start = data.find(b"landscape.ini") + len("landscape.ini")
    data[start + 9 : start + 24] = bytes(15)
    path.write_bytes(data)


def package(path: Path) -> bytes:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("x/landscape.ini", INI)
        archive.writestr("x/a.png", picture("PNG"))
        archive.writestr("b", b"")
    return path.read_bytes()


def nameless(path: Path) -> None:
    """The last member, whose name has one letter, is called by a null, which ends a name."""
    data = bytearray(package(path))
    start = data.rindex(b"PK\x01\x02")
    data[start + 46] = 0
    path.write_bytes(data)


def long_list(path: Path) -> None:
    """A list of 50,000 members, all of them the last one; nobody reads the number that the archive states."""
    data = package(path)
    start, end = data.index(b"PK\x01\x02"), data.rindex(b"PK\x05\x06")
    entries = data[start:end] + data[data.rindex(b"PK\x01\x02") : end] * 50_000
    path.write_bytes(
        data[:start] + entries + data[end : end + 12] + len(entries).to_bytes(4, "little") + data[end + 16 :]
    )


def picture(kind: str) -> bytes:
    made = io.BytesIO()
    Image.new("RGBA", (64, 32)).save(made, kind)
    return made.getvalue()


def strip_in_words(path: Path) -> None:
    """A TIFF whose tag 273, the place of its pixels, holds text in place of a number."""
    data = picture("TIFF")
    number = data.index(b"\x11\x01\x04\x00")
    path.write_bytes(data[: number + 2] + b"\x02" + data[number + 3 :])


def circle(path: Path) -> None:
    path.symlink_to(path.name)


ENDLESS = ("NAXIS   = 2", "NAXIS1  =                1E400", "NAXIS2  = 3")
# Key, file, how it is forged, what the message says.
ATTACKS = {
    "picture of two parts": (
        "landscape", "a.exr", parts(part("a", 16, "RGB"), part("b", 16, "WXYZ")), "has 2 parts"
    ),
    "stack of two parts": ("stack", "a.exr", parts(part("a", 15, "A"), part("b", 15, "WXYZ")), "found 2 parts"),
    "endless side": ("stack", "a.fits", fits_header(*ENDLESS), "float infinity"),
    "half a word": ("stack", "a.fits", fits_header("NAXIS   = 'abc"), "Unparsable card"),
    "damaged LZMA": ("landscape", "a.zip", damaged_lzma, r"landscape\.ini' is compressed by LZMA, which is not read"),
    "words for numbers": ("landscape", "a.tif", strip_in_words, r"'a\.tif' cannot be read as a picture \("),
    "no name": ("landscape", "a.zip", nameless, "has a file without a name, so it is damaged: pack it again"),
    "long list of members": ("landscape", "a.zip", long_list, "a list of files of more than 2000000 bytes"),
    "links in a circle": ("landscape", "a.png", circle, "cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("attack", ATTACKS)
def test_forged_files_beside_a_scenario_are_refused(tmp_path, attack) -> None:
    key, name, forge, words = ATTACKS[attack]
    forge(tmp_path / name)
    tree = BASE | {"name": "hostile"}
    if key == "stack":
        tree |= {"camera": BASE["camera"] | {"psf": {"stack": {"file": name, "oversampling": 1}}}}
    else:
        tree |= {"foreground": {"landscape": {"file": name}}}
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(tree))
    with pytest.raises(ScenarioError, match=rf"{key}.*{words}"):
        load_scenario(tmp_path / "a.yaml")


def test_entries_of_a_long_list_are_not_made(tmp_path, monkeypatch) -> None:
    long_list(tmp_path / "a.zip")
    monkeypatch.setattr(zipfile, "ZipInfo", lambda *given: pytest.fail("an entry was read"))
    with pytest.raises(PackageError, match=r"'a\.zip' .* at most 2000 files: pack one landscape's folder"):
        read_landscape(tmp_path / "a.zip", "a.zip")


def test_a_red_channel_without_green_and_blue_leaves_the_picture_grey(tmp_path) -> None:
    for channels in ("RY", "Y"):
        parts(part("a", 16, channels))(tmp_path / f"{channels}.exr")
    red, grey = (read_linear(tmp_path / f"{channels}.exr", "a.exr", None) for channels in ("RY", "Y"))
    np.testing.assert_array_equal(red.rgba, grey.rgba)
