"""What frames are known by: the generator's revision, and the hash of an image's pixels."""

from __future__ import annotations

import functools
import hashlib
import io
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import platformdirs
import pytest
from PIL import Image
from small_scenes import small_scenario

from generator.identity import revision
from generator.identity.behaviour import Sources
from generator.identity.pixels import pixels_sha256
from generator.scenario import file as scenario_file

PACKAGE = Path(revision.__file__).parents[1]
DATA = "0" * 64


@functools.cache
def sources() -> Sources:
    files = sorted(PACKAGE.rglob("*.py"))
    return revision.sources_of({path.relative_to(PACKAGE.parent).as_posix(): path.read_bytes() for path in files})


def edited(module: str, before: str, after: str) -> str:
    text = sources().modules[module]
    assert before in text
    return revision.revision_of(sources().edited({module: text.replace(before, after)}), DATA)


def test_a_change_of_what_makes_frames_changes_the_revision() -> None:
    today = revision.revision_of(sources(), DATA)
    assert edited("generator.sensor.readout", "import numpy as np", "import numpy as np\n\nEXTRA = 1") != today
    assert edited("generator.places.refraction", "import numpy as np", "import numpy as np\n\nEXTRA = 1") != today
    assert revision.revision_of(sources(), "1" * 64) != today


def test_words_and_code_that_makes_no_frames_do_not_change_it() -> None:
    today = revision.revision_of(sources(), DATA)
    assert edited("generator.seeds", "Named, independent random streams.", "Streams.") == today
    assert edited("generator.export.coco", "import json", "import json\n\nEXTRA = 1") == today


def test_it_is_kept_and_a_damaged_copy_is_made_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda name: tmp_path)
    monkeypatch.setattr(revision, "revision_of", lambda sources, data_digest: "fedcba9876543210")
    work = revision.generator_revision.__wrapped__
    first = work()
    (kept,) = tmp_path.iterdir()
    assert kept.read_text() == first
    kept.write_text("0123456789abcdef")
    assert work() == "0123456789abcdef"  # taken from the copy, not worked out
    for damaged in (b"", b"\xff\xfe", b"0123456789abcdef and more"):
        kept.write_bytes(damaged)
        assert work() == first == kept.read_text()


def test_a_folder_that_cannot_be_written_only_costs_the_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda name: tmp_path / "file" / "cache")
    assert revision.generator_revision.__wrapped__() == revision.generator_revision()


def test_a_scenario_has_another_hash_with_another_generator(monkeypatch: pytest.MonkeyPatch) -> None:
    today = small_scenario()
    assert today.sha256 == small_scenario().sha256
    monkeypatch.setattr(scenario_file, "generator_revision", lambda: "0" * 16)
    assert small_scenario().sha256 != today.sha256
    assert small_scenario().content_sha256 == today.content_sha256


def test_a_hash_is_had_without_the_renderer() -> None:
    code = (
        "import sys; from generator.scenario.file import load_scenario; from pathlib import Path; "
        "load_scenario(Path('scenes/00_hello.yaml')).sha256; print({'mitsuba', 'drjit'} & set(sys.modules))"
    )
    root = PACKAGE.parent
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout == "set()\n"


def test_pixels_have_the_hash_that_the_documents_describe() -> None:
    image = np.array([[0, 1, 2], [256, 4095, 65535]], dtype=np.uint16)
    by_hand = hashlib.sha256(b"skybench-pixels/1:2:2x3:" + struct.pack("<6H", 0, 1, 2, 256, 4095, 65535)).hexdigest()
    assert pixels_sha256(image) == by_hand == pixels_sha256(image.astype(">u2"))
    assert pixels_sha256(image[:, ::-1]) != by_hand != pixels_sha256(image.reshape(3, 2))
    grey = image.astype(np.uint8)
    assert pixels_sha256(grey) not in {by_hand, pixels_sha256(np.stack([grey] * 3, axis=-1))}


def test_a_file_that_was_compressed_anew_has_the_same_pixels() -> None:
    image = np.random.default_rng(3).integers(0, 65536, (40, 30), dtype=np.uint16)
    files = []
    for level in (0, 9):
        stream = io.BytesIO()
        Image.fromarray(image).save(stream, format="PNG", compress_level=level)
        files.append(stream.getvalue())
    assert files[0] != files[1]
    hashes = {pixels_sha256(np.asarray(Image.open(io.BytesIO(content))).astype(np.uint16)) for content in files}
    assert hashes == {pixels_sha256(image)}
