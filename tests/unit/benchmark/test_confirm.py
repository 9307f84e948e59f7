"""Results of an older generator become results of today's where, and only where, its frames are the same bytes."""

from __future__ import annotations

import dataclasses
import shutil

import numpy as np
import pytest
from PIL import Image
from unit.benchmark.fake_night import Truth, write_dataset
from unit.benchmark.stored import stored

from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import FrameSet, ungraded
from benchmark.run import engine
from benchmark.run.confirm import confirm
from benchmark.run.packed import read_packed
from benchmark.run.packing import pack_tree, write_packed
from benchmark.run.provenance import result_key
from generator.identity.revision import GENERATOR_REVISION

LATER = {"skybench": "9.9", GENERATOR_REVISION: "f" * 16}


@dataclasses.dataclass(frozen=True)
class Settled(Truth):
    """The truth, with a revision."""

    revision: str = "one"


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Frames in ``night``, packed results of two solvers in ``out``."""
    root = tmp_path_factory.mktemp("confirm")
    folder = write_dataset(root / "night", (1, 2), per_class=2)
    frames = open_dataset(folder).frames
    engine.run(folder, [Settled("one", frames), Settled("two", frames)], root / "out")
    pack_tree(root / "out")
    return root


@pytest.fixture
def folder(solved, tmp_path):
    return shutil.copytree(solved / "night", tmp_path / "night")


@pytest.fixture
def out(solved, tmp_path):
    return shutil.copytree(solved / "out", tmp_path / "out")


def by_a_later_generator(folder) -> FrameSet:
    """The frames of a folder as if a generator of another revision had rendered them."""
    found = ungraded(open_dataset(folder), str(folder))
    return FrameSet(dataclasses.replace(found.facts, scenario_sha256="1" * 64, rendered_with=LATER), found.frames)


def test_results_of_the_same_frames_are_of_todays(folder, out):
    before = stored(out)
    today = by_a_later_generator(folder)
    confirmed = confirm(out, today)
    assert (confirmed.n_frames, confirmed.solvers) == (4, ("one", "two"))
    after = stored(out)
    for name in ("one", "two"):
        source = after[name].provenance
        assert source.frames.scenario_sha256 == "1" * 64
        assert source.frames.rendered_again_with == LATER
        assert source.frames.rendered_with == before[name].provenance.frames.rendered_with
        assert source.key == after[name].key == result_key(name, source.solver, today.facts)
        assert after[name].frames.equals(before[name].frames)
    assert confirm(out, today).solvers == ()


def test_results_get_the_circumstances_that_todays_records_state(folder, out):
    before = {name: result.frames for name, result in stored(out).items()}
    today = by_a_later_generator(folder)
    frames = [
        dataclasses.replace(one, conditions=dataclasses.replace(one.conditions, moon_altitude_deg=place - 7.25))
        for place, one in enumerate(today.frames)
    ]
    confirm(out, FrameSet(today.facts, tuple(frames)))
    altitude = {frame.frame_id: frame.conditions.moon_altitude_deg for frame in frames}
    for name, result in stored(out).items():
        assert result.frames.set_index("frame_id")["moon_altitude_deg"].to_dict() == altitude
        assert result.frames.drop(columns="moon_altitude_deg").equals(before[name].drop(columns="moon_altitude_deg"))


def change_the_image(folder):
    path = folder / "frame-00002.png"
    with Image.open(path) as picture:
        image = np.array(picture).astype(np.uint16)
    image[3, 4] ^= 1
    Image.fromarray(image).save(path)


def test_one_changed_pixel_refuses_them_all(folder, out):
    (listing,) = out.rglob("*.json")
    before = listing.read_bytes()
    change_the_image(folder)
    with pytest.raises(
        ResultsError, match=r"frame-00002 of one is not what the generator renders today \(another image\)"
    ):
        confirm(out, by_a_later_generator(folder))
    assert listing.read_bytes() == before


def test_another_star_refuses_them(folder, out):
    today = by_a_later_generator(folder)
    first, *others = today.frames
    moved = dataclasses.replace(first, truth=dataclasses.replace(first.truth, uv=first.truth.uv + 1e-12))
    with pytest.raises(ResultsError, match="another truth"):
        confirm(out, FrameSet(today.facts, (moved, *others)))


def test_fewer_frames_and_another_definition_refuse_them(folder, out):
    today = by_a_later_generator(folder)
    with pytest.raises(ResultsError, match="which the task does not have today"):
        confirm(out, FrameSet(today.facts, today.frames[:-1]))
    with pytest.raises(ResultsError, match="another definition"):
        confirm(out, FrameSet(dataclasses.replace(today.facts, definition_sha256="2" * 64), today.frames))


def test_results_that_state_no_hashes_are_refused(folder, out):
    (listing,) = out.rglob("*.json")
    rows = [
        dataclasses.replace(row, frames=row.frames.assign(image_sha256=None, truth_sha256=None))
        for row in read_packed(listing)
    ]
    write_packed(listing, rows)
    with pytest.raises(ResultsError, match="one states no hashes of frame-00000"):
        confirm(out, by_a_later_generator(folder))


def test_what_is_not_packed_is_refused(folder, tmp_path):
    today = by_a_later_generator(folder)
    with pytest.raises(ResultsError, match="no packed results"):
        confirm(tmp_path / "none", today)
