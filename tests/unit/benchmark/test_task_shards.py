"""Frames of a task on disk: those that are there are used again, and no choice of fewer frames costs any of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from unit.benchmark.test_sequence_tasks import BY_FRAMES, SEQUENCES
from unit.benchmark.test_tasks import TINY, TINY_SCENARIO

from benchmark.frames import task_frames
from benchmark.frames.dataset import truth_digest
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.task_frames import FrameChoice, at_hand, make_task_frames, split_folder
from benchmark.frames.task_shards import SHARD_FRAMES, chosen_shards, star_folders
from benchmark.tasks.definition import Task, load_task
from generator.dataset.layout import DatasetSpec, Shard
from generator.dataset.run import run_shards
from generator.dataset.target import LocalTarget

SMALL = TINY_SCENARIO.replace("width: 270, height: 180", "width: 60, height: 40")


def write_task(folder: Path, definition: str = TINY, scenario: str = SMALL) -> Task:
    (folder / "tiny.task.yaml").write_text(definition)
    (folder / "tiny.scenario.yaml").write_text(scenario)
    return load_task("tiny", folder)


def first(folder: Path, count: int | None, condition: float | None = 5.0) -> FrameChoice:
    return FrameChoice(per_condition=count, condition=condition, data=folder / "data", workers=0)


def folder_of(task: Task, choice: FrameChoice) -> Path:
    return split_folder(task.label, choice.split, task.scenario_of(choice.split).sha256, choice.data)


def written(folder: Path) -> dict[Path, tuple[int, int]]:
    """Every file, and when and with which inode it was written."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in paths}


def same_frames(made: FrameSet, expected: FrameSet) -> bool:
    """Whether a set is the beginning of another: images, records and truth."""
    others = expected.frames[: len(made.frames)]
    files = [(one.image_path.read_bytes(), one.image_path.with_suffix(".json").read_bytes()) for one in made.frames]
    theirs = [(one.image_path.read_bytes(), one.image_path.with_suffix(".json").read_bytes()) for one in others]
    stars = all(
        np.array_equal(one.truth.star_id, other.truth.star_id) for one, other in zip(made.frames, others, strict=True)
    )
    return files == theirs and stars and truth_digest(made.frames) == truth_digest(others)


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """First and last frame of every shard that is rendered, in order."""
    asked = []

    def noting(scenario: Any, spec: Any, shards: list[Shard], *others: Any) -> Any:
        asked.extend((shard.first, shard.stop - 1) for shard in shards)
        return run_shards(scenario, spec, shards, *others)

    monkeypatch.setattr(task_frames, "run_shards", noting)
    return asked


def test_the_first_frames_are_the_same_however_many_are_asked_for() -> None:
    scenario = load_task("bortle").scenario_of("dev")

    def indices(n: int) -> set[int]:
        shards = [one.chosen for one in chosen_shards(150, n, "dev", range(11))]
        return {i for shard in shards for i in range(shard.first, shard.stop)}

    assert indices(3) < indices(25) < indices(150) == set(range(scenario.frame_count))
    assert indices(3) == {150 * condition + i for condition in range(11) for i in range(3)}
    full = {one.whole.index: one for one in chosen_shards(150, 150, "dev", range(11))}
    assert len(full) == 165
    assert all(one.chosen == one.whole for one in full.values())
    assert all(full[one.whole.index] == one for one in chosen_shards(150, 20, "dev", range(11)))
    assert all(full[one.whole.index].whole == one.whole for one in chosen_shards(150, 25, "dev", range(11)))
    # The last shard of a condition has what is left; all of it is a whole shard.
    assert [one.chosen == one.whole for one in chosen_shards(15, 15, "dev", [0])] == [True, True]
    assert [one.chosen == one.whole for one in chosen_shards(15, 13, "dev", [0])] == [True, False]


def test_frames_that_are_gone_are_unpacked_again_and_the_others_left_alone(tmp_path: Path) -> None:
    task, choice = write_task(tmp_path), first(tmp_path, 2)
    frames = make_task_frames(task, "tiny", choice).frames
    one, other = (frame.image_path for frame in frames)
    image = other.read_bytes()
    before = one.stat().st_mtime_ns
    other.unlink()
    make_task_frames(task, "tiny", choice)
    assert other.read_bytes() == image
    assert one.stat().st_mtime_ns == before


def test_fewer_frames_than_there_are_change_no_file(tmp_path: Path, rendered: list[tuple[int, int]]) -> None:
    task = write_task(tmp_path)
    whole = make_task_frames(task, "tiny", first(tmp_path, None))
    before = written(tmp_path / "data")
    counted: list[int] = []
    for count in (3, 9, 10):
        assert at_hand(task, first(tmp_path, count))
        made = make_task_frames(task, "tiny", first(tmp_path, count), counted.append)
        assert len(made.frames) == count
        assert same_frames(made, whole)
    assert rendered == [(0, 9)]
    assert counted == [3, 9, 10]
    assert written(tmp_path / "data") == before


def test_of_a_whole_shard_only_the_chosen_frames_are_unpacked(tmp_path: Path) -> None:
    task = write_task(tmp_path)
    whole = make_task_frames(task, "tiny", first(tmp_path, None))
    for frame in whole.frames:
        frame.image_path.unlink()
    made = make_task_frames(task, "tiny", first(tmp_path, 2))
    assert [frame.image_path.is_file() for frame in whole.frames] == [True] * 2 + [False] * 8
    assert [frame.frame_id for frame in made.frames] == ["frame-00000", "frame-00001"]


def test_more_frames_than_there_are_begin_with_the_same(tmp_path: Path, rendered: list[tuple[int, int]]) -> None:
    """Of three conditions, whose shards have frames of one condition each."""
    task = write_task(tmp_path)
    few = make_task_frames(task, "tiny", first(tmp_path, 2, None))
    choices = {frame.frame_id: frame.image_path.read_bytes() for frame in few.frames}
    assert rendered == [(0, 1), (10, 11), (20, 21)]
    assert not at_hand(task, first(tmp_path, 3, None))
    more = make_task_frames(task, "tiny", first(tmp_path, 3, None))
    assert {frame.frame_id: frame.image_path.read_bytes() for frame in more.frames} | choices == {
        frame.frame_id: frame.image_path.read_bytes() for frame in more.frames
    }
    assert [frame.condition for frame in more.frames] == [5.0] * 3 + [4.0] * 3 + [3.0] * 3
    assert rendered[3:] == [(0, 2), (10, 12), (20, 22)]
    before = written(tmp_path / "data")
    again = make_task_frames(task, "tiny", first(tmp_path, 2, None))
    assert again.facts.truth_sha256 == few.facts.truth_sha256
    assert len(rendered) == 6
    assert written(tmp_path / "data") == before


def test_a_run_with_fewer_frames_takes_none_from_one_that_renders_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The larger run begins and ends while the smaller one, which found no frames, renders its own."""
    task, larger = write_task(tmp_path), []

    def meanwhile(*arguments: Any) -> Any:
        monkeypatch.setattr(task_frames, "run_shards", run_shards)
        larger.append(make_task_frames(task, "tiny", first(tmp_path, None)))
        larger.append(written(folder / "data"))
        return run_shards(*arguments)

    folder = folder_of(task, first(tmp_path, 3))
    monkeypatch.setattr(task_frames, "run_shards", meanwhile)
    made = make_task_frames(task, "tiny", first(tmp_path, 3))
    assert len(larger[0].frames) == SHARD_FRAMES
    assert written(folder / "data") == larger[1]
    assert same_frames(made, larger[0])
    assert at_hand(task, first(tmp_path, None))


def test_a_shard_that_was_cut_short_is_used_and_becomes_whole(tmp_path: Path, rendered: list[tuple[int, int]]) -> None:
    """In the folder of whole shards there may be one with fewer frames."""
    task = write_task(tmp_path)
    choice = first(tmp_path, 3)
    cut, spec = Shard(0, 0, 3, "dev"), DatasetSpec(split="dev", shard_size=SHARD_FRAMES)
    (folder_of(task, choice)).mkdir(parents=True)
    (folder_of(task, choice) / "scenario.yaml").write_text(task.text_of("dev"))
    list(run_shards(task.scenario_of("dev"), spec, [cut], LocalTarget(folder_of(task, choice)), 0))
    few = make_task_frames(task, "tiny", choice)
    make_task_frames(task, "tiny", first(tmp_path, 2))
    assert rendered == []
    assert same_frames(few, make_task_frames(task, "tiny", first(tmp_path, None)))
    assert rendered == [(0, 9)]


def test_sequences_end_within_a_shard(tmp_path: Path, rendered: list[tuple[int, int]]) -> None:
    """Ten sequences of three frames: four end two frames after the first shard, five at the middle of the second."""
    task = write_task(tmp_path, BY_FRAMES, SEQUENCES.replace("width: 270, height: 180", "width: 60, height: 40"))
    four = make_task_frames(task, "tiny", first(tmp_path, 4, None))
    assert rendered == [(0, 9), (10, 11)]
    five = make_task_frames(task, "tiny", first(tmp_path, 5, None))
    assert rendered[2:] == [(10, 14)]
    assert same_frames(four, five)
    places = [frame.observation.sequence for frame in five.frames]
    assert [(place.index, place.sequence_id[-1]) for place in places if place] == [
        (index, str(number)) for number in range(5) for index in range(3)
    ]
    one = make_task_frames(task, "tiny", first(tmp_path, 1, None))
    assert same_frames(one, five)
    assert len(rendered) == 3


def test_tables_of_stars_are_found_for_whole_shards_and_beginnings(tmp_path: Path) -> None:
    task = write_task(tmp_path)
    for count, expected in ((2, ["beginnings/02/"]), (None, ["", "beginnings/02/"])):
        make_task_frames(task, "tiny", first(tmp_path, count))
        folder = folder_of(task, first(tmp_path, count))
        tables = [path for each in star_folders(folder, "dev") for path in each.glob("*.parquet")]
        assert tables == [folder / f"{place}stars/dev/shard-000000.parquet" for place in expected]
