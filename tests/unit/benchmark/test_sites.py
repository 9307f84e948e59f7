"""Frames that are counted together: of one place and night, and of one sequence."""

import dataclasses
import json
from pathlib import Path

import pandas as pd
import pytest
from unit.benchmark.fake_night import write_dataset

from benchmark.errors import DatasetError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import ungraded
from benchmark.frames.sites import own_site, with_sites
from benchmark.judge.answers import failure, judge_answer
from benchmark.stats.frame_metrics import resamples_of
from benchmark.tasks.definition import load_task

BOARD = Path(__file__).parents[3] / "results" / "leaderboard" / "uav@1" / "dev.parquet"


def flights(folder, count, per_flight, north_deg=10.0):
    """A folder of flights, each of which begins `north_deg` further north and moves on by a kilometre a frame."""
    write_dataset(folder, (1,) * count, per_class=per_flight)
    for index in range(count * per_flight):
        path = folder / f"frame-{index:05d}.json"
        record = json.loads(path.read_text())
        number, step = divmod(index, per_flight)
        record["site"] |= {"latitude_deg": north_deg * number + 0.01 * step, "longitude_deg": 5.0}
        record["sequence"] = {"index": number, "step": step, "start_s": 2.0 * step, "velocity_enu_m_s": [0, 555, 0]}
        path.write_text(json.dumps(record))
    return open_dataset(folder)


def clusters(frames):
    rows = [{"frame_id": frame.frame_id, "site": frame.site} for frame in frames]
    return resamples_of(pd.DataFrame(rows)).n_clusters


def test_the_frames_of_a_flight_are_one_site(tmp_path):
    dataset = flights(tmp_path / "night", 2, 3)
    frames = ungraded(dataset, "night").frames
    assert [frame.site for frame in frames] == [own_site(frames[0])] * 3 + [own_site(frames[3])] * 3
    assert clusters(frames) == 2
    assert len({own_site(frame) for frame in frames}) == 6, "each is at another place"
    # In whatever order they come, the first frame says where.
    assert {frame.site for frame in with_sites(reversed(frames))} == {own_site(frames[0]), own_site(frames[3])}


def test_flights_from_one_place_in_one_night_share_its_sky(tmp_path):
    assert clusters(ungraded(flights(tmp_path / "night", 2, 3, north_deg=0.0), "night").frames) == 1


def test_frames_by_themselves_keep_their_own_sites(tmp_path):
    dataset = open_dataset(write_dataset(tmp_path / "night", (1, 2), per_class=3))
    frames = ungraded(dataset, "night").frames
    assert [frame.site for frame in frames] == [own_site(frame) for frame in dataset.frames]
    assert clusters(frames) == 3


def test_a_wrong_step_is_refused_by_its_key(tmp_path):
    folder = tmp_path / "night"
    flights(folder, 1, 2)
    path = folder / "frame-00001.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"sequence": {"index": 0, "step": -1}}))
    with pytest.raises(DatasetError, match=r"sequence\.step must be at least 0"):
        open_dataset(folder)


def test_committed_results_of_sequences_have_the_sites_of_first_frames():
    table = pd.read_parquet(BOARD, columns=["index", "site"])
    sequence = table["index"] // load_task("uav").sequence_length
    first = table.groupby(sequence)["site"].transform("first")
    assert (table["site"] == first).all()
    assert table["site"].nunique() == sequence.nunique()


def test_a_judged_frame_has_the_site_that_it_is_counted_with(tmp_path):
    frame = flights(tmp_path / "night", 1, 1).frames[0]
    assert judge_answer(frame, failure("none", 1.0), None).details.site == own_site(frame)
    assert (
        judge_answer(dataclasses.replace(frame, site="elsewhere"), failure("none", 1.0), None).details.site
        == "elsewhere"
    )
