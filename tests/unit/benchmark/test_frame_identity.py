"""A frame's identity is the hash of its image and truth; a frame that is not what a result says is not used."""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
import struct

import numpy as np
import pytest
from PIL import Image
from unit.benchmark.fake_night import Truth, write_dataset
from unit.benchmark.stored import stored

from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import ungraded
from benchmark.frames.identity import UNKNOWN, FrameIdentity, identity_of, truth_sha256_of
from benchmark.run import engine
from benchmark.run.identities import identities_in, recorded_identities
from benchmark.run.journal import Journal
from benchmark.run.packing import pack_tree
from benchmark.run.results import read_table


@dataclasses.dataclass(frozen=True)
class Settled(Truth):
    """The truth, with a revision, so that its results can be told from others'."""

    revision: str = "one"


@pytest.fixture
def folder(tmp_path):
    return write_dataset(tmp_path / "night", (1, 2), per_class=2)


def change_a_pixel(folder, name="frame-00002"):
    path = folder / f"{name}.png"
    with Image.open(path) as picture:
        image = np.array(picture).astype(np.uint16)
    image[3, 4] ^= 1
    Image.fromarray(image).save(path)


def test_results_carry_the_hash_of_every_image_and_truth(folder, tmp_path):
    frames = open_dataset(folder).frames
    engine.run(folder, [Settled("one", frames)], tmp_path / "out")
    table = stored(tmp_path / "out")["one"].frames.set_index("frame_id")
    for frame in frames:
        with Image.open(frame.image_path) as picture:
            image = np.asarray(picture)
        head = f"skybench-pixels/1:2:{image.shape[0]}x{image.shape[1]}:".encode()
        body = struct.pack(f"<{image.size}H", *image.ravel().tolist())
        assert table["image_sha256"][frame.frame_id] == hashlib.sha256(head + body).hexdigest()
        assert table["truth_sha256"][frame.frame_id] == truth_sha256_of(frame)
    assert table["image_sha256"].nunique() == table["truth_sha256"].nunique() == len(frames)


def test_the_truth_of_a_frame_is_its_place_and_its_stars_not_its_name(folder):
    frame = open_dataset(folder).frames[0]
    same = truth_sha256_of(frame)
    assert truth_sha256_of(dataclasses.replace(frame, frame_id="other", index=7)) == same
    moved = dataclasses.replace(frame.conditions, latitude_deg=np.nextafter(frame.conditions.latitude_deg, 90.0))
    brighter = dataclasses.replace(frame.truth, electrons_e=frame.truth.electrons_e * (1 + 1e-15))
    assert truth_sha256_of(dataclasses.replace(frame, conditions=moved)) != same
    assert truth_sha256_of(dataclasses.replace(frame, truth=brighter)) != same


def test_a_changed_frame_is_refused_beside_results_on_the_first_one(folder, tmp_path):
    frames, out = open_dataset(folder).frames, tmp_path / "out"
    engine.run(folder, [Settled("one", frames)], out)
    change_a_pixel(folder)
    with pytest.raises(ResultsError, match=r"frame-00002: its image is not the one that .*one-\w+ is of"):
        engine.run(folder, [Settled("two", frames)], out)
    (elsewhere,) = engine.run(folder, [Settled("two", frames)], tmp_path / "elsewhere")
    assert elsewhere.n_solved == 4


def test_packed_results_state_identities_too(folder, tmp_path):
    frames, out = open_dataset(folder).frames, tmp_path / "out"
    engine.run(folder, [Settled("one", frames)], out)
    facts = ungraded(open_dataset(folder), str(folder)).facts
    raw = {name: identity for name, (identity, _) in recorded_identities(out, facts).items()}
    pack_tree(out)
    assert not list(out.rglob("summary.json"))
    packed = {name: identity for name, (identity, _) in recorded_identities(out, facts).items()}
    assert raw == packed == {frame.frame_id: identity_of(frame) for frame in frames}
    assert recorded_identities(out, dataclasses.replace(facts, scenario_sha256="0" * 64)) == {}
    change_a_pixel(folder)
    with pytest.raises(ResultsError, match=r"frame-00002: its image"):
        engine.run(folder, [Settled("two", frames)], out)


def test_results_with_other_frames_are_not_packed_together(folder, tmp_path):
    frames, out = open_dataset(folder).frames, tmp_path / "out"
    engine.run(folder, [Settled("one", frames)], out)
    change_a_pixel(folder)
    engine.run(folder, [Settled("two", frames)], tmp_path / "elsewhere")
    (theirs,) = (path.parent for path in (tmp_path / "elsewhere").rglob("summary.json"))
    shutil.copytree(theirs, out / theirs.relative_to(tmp_path / "elsewhere"))
    with pytest.raises(ResultsError, match="their frames differ"):
        pack_tree(out)


def test_an_interrupted_run_begins_again_where_a_frame_is_another_one(folder, tmp_path):
    frames, ended = open_dataset(folder).frames, []

    def stop(name, count):
        ended.extend([name] * count)
        if len(ended) == 3:
            raise KeyboardInterrupt

    for changed, left in ((False, 1), (True, 4)):
        out = tmp_path / f"out-{changed}"
        ended.clear()
        with pytest.raises(KeyboardInterrupt):
            engine.run(folder, [Settled("one", frames)], out, progress=stop)
        if changed:
            change_a_pixel(folder, "frame-00001")
        (run,) = engine.run(folder, [Settled("one", frames)], out)
        assert run.n_solved == left
        assert len(stored(out)["one"].frames) == 4


def test_results_of_earlier_formats_have_unknown_identities(folder, tmp_path):
    frames, out = open_dataset(folder).frames, tmp_path / "out"
    (run,) = engine.run(folder, [Settled("one", frames)], out)
    earlier = read_table(run.folder / "frames.parquet").drop_columns(["image_sha256", "truth_sha256"]).to_pandas()
    assert set(identities_in(earlier).values()) == {UNKNOWN}
    assert not UNKNOWN.contradicts(FrameIdentity("a", "b"))
    assert FrameIdentity("a", None).contradicts(FrameIdentity("b", None))
    assert not FrameIdentity("a", None).contradicts(FrameIdentity("a", "b"))
    assert Journal(tmp_path / "none", {}, True).take_over(frames) == set()
