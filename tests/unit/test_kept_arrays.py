"""Arrays that processes keep for each other: the same numbers with and without, none of other inputs or another code."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import platformdirs
import pytest
from numpy.typing import NDArray

from generator.ground.panorama import Panorama
from generator.ground.skylines.draw import skyline_panorama
from generator.ground.skylines.stored import NUMBERS, arrays_of, panorama_of
from generator.identity import kept as module
from generator.identity.kept import described, kept

Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class Lens:
    width: float
    name: str | None = None


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda name: tmp_path)
    monkeypatch.setattr(module, "_surroundings", lambda: "today")
    module._written.clear()
    return tmp_path / module.FOLDER


def numbers(seed: int = 1) -> Arrays:
    random = np.random.default_rng(seed)
    return {"single": random.random((3, 4)).astype(np.float32).T, "kinds": np.array(["a", "bc"])}


def refuse() -> Arrays:
    raise AssertionError("computed again")


def same(first: Arrays, second: Arrays) -> bool:
    return first.keys() == second.keys() and all(
        array.dtype == second[name].dtype and array.strides == second[name].strides and (array == second[name]).all()
        for name, array in first.items()
    )


def test_what_is_kept_is_what_was_computed(folder: Path) -> None:
    made = kept("lens", (Lens(1.0), 2), numbers)
    assert made["single"].flags.c_contiguous
    assert same(made, kept("lens", (Lens(1.0), 2), refuse))
    assert len(list(folder.iterdir())) == 1


def test_other_inputs_names_and_code_have_their_own(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept("lens", (Lens(1.0), 2), numbers)
    for name, inputs in (("lens", (Lens(1.0), 3)), ("lens", (Lens(1.0, "1"), 2)), ("sky", (Lens(1.0), 2))):
        with pytest.raises(AssertionError, match="computed again"):
            kept(name, inputs, refuse)
    monkeypatch.setattr(module, "_surroundings", lambda: "another revision")
    with pytest.raises(AssertionError, match="computed again"):
        kept("lens", (Lens(1.0), 2), refuse)


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-30], lambda data: b"", lambda data: data[:180] + b"?" + data[181:]]
)
def test_a_damaged_file_is_computed_again(folder: Path, damage: Callable[[bytes], bytes]) -> None:
    made = kept("lens", (1,), numbers)
    (path,) = folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    assert same(made, kept("lens", (1,), numbers))
    assert same(made, kept("lens", (1,), refuse))


def test_no_file_makes_python_objects(folder: Path) -> None:
    made = kept("lens", (1,), numbers)
    (path,) = folder.iterdir()
    np.savez(path, single=np.array([{}], dtype=object))
    assert same(made, kept("lens", (1,), numbers))


def test_where_nothing_can_be_written_it_is_computed(folder: Path) -> None:
    folder.write_bytes(b"a file where the folder would be")
    assert same(kept("lens", (1,), numbers), kept("lens", (1,), numbers))


def test_the_longest_unused_go(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(3):
        kept("lens", (number,), numbers)
        for age, path in enumerate(sorted(folder.iterdir(), key=lambda each: each.stat().st_mtime)):
            os.utime(path, (1000 + age, 1000 + age))
    size = next(folder.iterdir()).stat().st_size
    kept("lens", (0,), refuse)
    monkeypatch.setattr(module, "MOST_BYTES", 3 * size)
    kept("lens", (3,), numbers)
    assert len(list(folder.iterdir())) == 3
    for number in (0, 2, 3):
        kept("lens", (number,), refuse)


def test_a_process_whose_frames_have_lenses_of_their_own_keeps_few(folder: Path) -> None:
    for number in range(module.MOST_WRITTEN + 3):
        kept("lens", (number,), numbers)
    assert len(list(folder.iterdir())) == module.MOST_WRITTEN


def test_a_text_tells_values_apart() -> None:
    values = [(1, 2), ((1, 2),), ("1", 2), (1.0, 2), (True, 2), (Lens(1.0), 2), (Lens(1.0), "2"), (None, 2)]
    assert len({described(value) for value in values}) == len(values)
    assert described(np.float64(0.1)) == described(0.1)
    with pytest.raises(TypeError, match="ndarray"):
        described((np.zeros(3),))


def test_a_skyline_is_the_same_from_arrays() -> None:
    drawn = skyline_panorama(["masts"], np.random.default_rng(1), 5.0)
    again = panorama_of(arrays_of(drawn), 5.0)
    for name in Panorama.__dataclass_fields__:
        first, second = getattr(drawn, name), getattr(again, name)
        if isinstance(first, np.ndarray):
            assert first.dtype == second.dtype
            assert (first == second).all()
        elif name != "lamps":
            assert first == second
    assert len(drawn.lamps) > 0
    assert [[getattr(lamp, each) for each in (*NUMBERS, "kind")] for lamp in drawn.lamps] == [
        [getattr(lamp, each) for each in (*NUMBERS, "kind")] for lamp in again.lamps
    ]
