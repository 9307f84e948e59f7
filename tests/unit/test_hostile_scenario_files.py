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
