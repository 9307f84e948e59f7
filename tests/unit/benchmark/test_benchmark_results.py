import dataclasses
import json
import math

import pyarrow.parquet as pq
import pytest
from unit.benchmark.fake_night import Mixed, Refusing, Truth, write_dataset
from unit.benchmark.stored import stored

from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.report.site.boards import make_board
from benchmark.report.site.tree import read_tree
from benchmark.run import engine
from benchmark.run.provenance import blanks
from benchmark.run.result_tables import scores_of
from benchmark.run.results import read_summary, write_result
from benchmark.stats.frame_metrics import measure, metrics_within, read_frames, success_metric
from benchmark.stats.metrics import summarise


@pytest.fixture
def folder(tmp_path):
    return write_dataset(tmp_path / "night", (1, 8, None), per_class=2)


@pytest.fixture
def out(folder, tmp_path):
    frames = open_dataset(folder).frames
    solvers = [Mixed("mixed", frames), Refusing("empty", frames), Truth("truth", frames)]
    engine.run(folder, solvers, tmp_path / "out")
    return tmp_path / "out"


def folder_of(out, name):
    (found,) = out.glob(f"*@*/all/own/{name}-*")
    return found


def refuse_constant(token):
    raise AssertionError(f"{token} is not JSON")


def test_summaries_are_strict_json_with_provenance(out):
    for name in ("mixed", "empty", "truth"):
        text = (folder_of(out, name) / "summary.json").read_text()
        summary = json.loads(text, parse_constant=refuse_constant)
        assert summary["solver"] == name
        assert (summary["definitions"], summary["limit_km"]) == ("skybench-metrics/2", 10.0)
        assert summary["provenance"]["frames"]["scenario_name"] == "fake night"
        assert len(summary["provenance"]["frames"]["truth_sha256"]) == 64
        assert {"skybench", "python", "numpy"} <= set(summary["provenance"]["versions"])
        assert set(summary["provenance"]["machine"]) == {"cpu", "cores", "system"}
        assert [entry["bortle"] for entry in summary["by_bortle"]] == [1, 8, None]
        assert str(out) not in text
    empty = json.loads((folder_of(out, "empty") / "summary.json").read_text())
    assert empty["overall"]["median_error_km"]["value"] is None
    assert empty["reasons"] == {"too few stars": 6}


def test_provenance_leaves_nothing_blank(out):
    for result in stored(out).values():
        assert blanks(result.provenance) == []
        assert result.provenance.frames.rendered_with == {"skybench": "0.0", "mitsuba": "0.0"}


def test_a_result_with_a_blank_provenance_is_not_written(out, tmp_path):
    result = stored(out)["truth"]
    frames = dataclasses.replace(result.provenance.frames, truth_sha256="")
    blank = dataclasses.replace(result.provenance, frames=frames)
    tables = [pq.read_table(result.folder / f"{name}.parquet") for name in ("frames", "matches")]
    with pytest.raises(ResultsError, match=r"leaves blank: frames\.truth_sha256"):
        write_result(tmp_path / "new", "truth", *tables, blank)
    assert not (tmp_path / "new").exists()


def test_the_board_counts_what_the_summary_counts(out):
    (group,) = read_tree(out)
    for entry in make_board(group).entries:
        overall = json.loads((entry.stored.folder / "summary.json").read_text())["overall"]
        assert entry.success.value == overall["recall"]["value"]
        assert len(entry.stored.frames) == overall["n_frames"] == 6


def test_a_summary_says_what_the_report_says(out):
    """Values and intervals alike, whatever the limit of the task."""
    for name in ("truth", "mixed", "empty"):
        frames = read_frames(folder_of(out, name) / "frames.parquet")
        scores = scores_of(pq.read_table(folder_of(out, name) / "frames.parquet"))
        for limit_km in (10.0, 300.0):
            summary = summarise(scores, limit_km)
            report = measure(frames, (*metrics_within(limit_km), success_metric(f"success_{limit_km:g}km")))
            assert summary.recall == report[f"success_{limit_km:g}km"]
            for key in ("wrong_and_confident", "median_error_km", "p90_error_km", "star_precision", "p95_time_ms"):
                assert repr(getattr(summary, key)) == repr(report[key]), key


def test_a_summary_of_graded_frames_has_the_variance_within_their_conditions(out):
    """Two conditions, one always solved and one never: the difference between them is the task's, not chance."""
    score = scores_of(pq.read_table(folder_of(out, "truth") / "frames.parquet"))[0]
    scores = [
        dataclasses.replace(
            score,
            frame_id=f"frame-{i:05d}",
            site=f"site {i}",
            error_km=1.0 if i < 40 else 99.0,
            condition=float(i < 40),
        )
        for i in range(80)
    ]
    graded, plain = summarise(scores), summarise([dataclasses.replace(one, condition=None) for one in scores])
    assert graded.recall.value == plain.recall.value == 0.5
    assert graded.recall.high - graded.recall.low < 0.5 * (plain.recall.high - plain.recall.low)
    assert graded.wrong_and_confident.high - graded.wrong_and_confident.low < 0.1


def test_the_summary_of_a_task_has_the_tasks_limit(out, tmp_path):
    result = stored(out)["mixed"]
    frames = dataclasses.replace(result.provenance.frames, metric="success_30000km")
    tables = [pq.read_table(result.folder / f"{name}.parquet") for name in ("frames", "matches")]
    folder = tmp_path / "new"
    folder.mkdir()
    summary = write_result(folder, "mixed", *tables, dataclasses.replace(result.provenance, frames=frames))
    assert summary.recall.value == summary.n_fixes / summary.n_frames > 0
    assert json.loads((folder / "summary.json").read_text())["limit_km"] == 30000.0


def test_an_earlier_summary_is_read_for_its_counts(out):
    path = folder_of(out, "truth") / "summary.json"
    text = path.read_text()
    path.write_text(text.replace("skybench-metrics/2", "skybench-metrics/1"))
    try:
        assert read_summary(path).n_frames == 6
    finally:
        path.write_text(text)


def test_tables_carry_units_and_provenance(out):
    table = pq.read_table(folder_of(out, "truth") / "frames.parquet")
    assert table.schema.field("error_km").metadata[b"unit"] == b"km"
    stamp = json.loads(table.schema.metadata[b"skybench"])
    assert (stamp["solver"], stamp["provenance"]["frames"]["scenario_name"]) == ("truth", "fake night")
    assert table["stage_ms"].to_pylist()[0] == [("look up", 0.1)]
    assert table["cov_nn_km2"].to_pylist() == [0.02] * 6
    matches = pq.read_table(folder_of(out, "truth") / "matches.parquet").to_pylist()
    assert {row["correct"] for row in matches if row["star_id"] is not None} == {True}


def test_frames_carry_what_statistics_sort_and_cluster_by(out):
    table = pq.read_table(folder_of(out, "mixed") / "frames.parquet")
    rows = table.to_pylist()
    # Midnight of 1 January in Munich and Reykjavik belongs to the night of 31 December, in South Africa too.
    assert rows[0]["site"] == "+48.0000 +11.0000 2019-12-31"
    assert len({row["site"] for row in rows}) == 3
    for row in rows:
        if row["status"] == "fix":
            assert math.hypot(row["error_east_km"], row["error_north_km"]) == pytest.approx(row["error_km"], abs=1e-9)
            # This contestant errs to the north and the south in turns.
            assert row["error_north_km"] * (-1) ** row["index"] > 0
        else:
            assert row["error_east_km"] is None
    assert {round(row["fov_deg"], 6) for row in rows} == {round(2 * math.degrees(math.atan2(80, 60)), 6)}
    assert {row["limiting_magnitude"] for row in rows} == {6.0}
    assert {(row["azimuth_deg"], row["altitude_deg"], row["roll_deg"]) for row in rows} == {(180.0, 90.0, 0.0)}
    # A record that says nothing of Moon, cloud or motion leaves them null.
    absent = ("moon_altitude_deg", "moon_illuminated", "cloud_optical_depth", "rate_deg_s", "crlb_km", "condition")
    assert all(row[name] is None for row in rows for name in absent)
    assert all(10 < row["peak_memory_mib"] < 100_000 for row in rows)
    for name, unit in (("error_east_km", b"km"), ("rate_deg_s", b"deg s-1"), ("peak_memory_mib", b"MiB")):
        assert table.schema.field(name).metadata[b"unit"] == unit


def test_circumstances_are_read_from_the_record(tmp_path):
    folder = write_dataset(tmp_path / "night", (4,))
    path = folder / "frame-00000.json"
    record = json.loads(path.read_text())
    record["sky"] |= {"moon_altitude_deg": 12.5, "moon_phase_angle_deg": 60.0}
    tenth = math.radians(0.1)
    turned = [[math.cos(tenth), -math.sin(tenth), 0.0], [math.sin(tenth), math.cos(tenth), 0.0], [0.0, 0.0, 1.0]]
    identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    record["attitude"] |= {"sample_time_s": [0.0, 0.25, 0.5], "sample_R_cam": [identity, turned, identity]}
    path.write_text(json.dumps(record))
    stars = pq.read_table(folder / "stars.parquet")
    pq.write_table(stars.append_column("cloud_optical_depth", [[0.5] * 6 + [1.5] * 6]), folder / "stars.parquet")
    found = open_dataset(folder).frames[0].conditions
    assert (found.moon_altitude_deg, found.cloud_optical_depth) == (12.5, 1.0)
    assert found.moon_illuminated == pytest.approx(0.75)
    assert found.rate_deg_s == pytest.approx(0.4)  # a tenth of a degree there and back in half a second


def test_a_result_is_read_from_its_own_folder_alone(out):
    folder = folder_of(out, "truth")
    (folder / "matches.parquet").unlink()  # large, and nothing but pictures needs it
    assert stored(out)["truth"].detections_in(["frame-00000"]) == {}
    folder.rename(folder.with_name("empty-0123456789ab"))
    with pytest.raises(ResultsError, match="result of 'truth'"):
        read_tree(out)


def test_refused_frames_have_no_error_in_the_table(out):
    table = pq.read_table(folder_of(out, "empty") / "frames.parquet")
    assert table["error_km"].null_count == 6
    assert set(table["status"].to_pylist()) == {"refused"}


def test_no_temporary_file_is_left(out):
    assert not [path for path in out.rglob("*") if path.name.endswith(".tmp")]


def test_results_of_another_dataset_are_kept_apart(out, tmp_path):
    other = write_dataset(tmp_path / "other", (4,))
    engine.run(other, [Truth("truth", open_dataset(other).frames)], out)
    groups = read_tree(out)
    assert [len(group) for group in groups] in ([1, 3], [3, 1])
    one, two = (group[0].provenance.frames for group in groups)
    assert one.label != two.label
    assert one.truth_sha256 != two.truth_sha256
    # Put together by force, they are not compared.
    with pytest.raises(ResultsError, match="cannot be compared"):
        make_board([groups[0][0], groups[1][0]])


def test_the_same_frames_elsewhere_have_the_same_label(out, tmp_path):
    again = write_dataset(tmp_path / "again", (1, 8, None), per_class=2)
    engine.run(again, [Truth("other", open_dataset(again).frames)], out)
    (group,) = read_tree(out)
    assert len(make_board(group).entries) == 4


def test_damaged_results_are_refused_by_name(out, tmp_path):
    with pytest.raises(ResultsError, match="no results"):
        read_tree(tmp_path / "nowhere")
    matches = folder_of(out, "mixed") / "matches.parquet"
    matches.write_bytes(b"no table")
    with pytest.raises(ResultsError, match=r"matches\.parquet: missing or damaged"):
        stored(out)["mixed"].detections_in(["frame-00000"])
    (folder_of(out, "empty") / "summary.json").write_text("{}")
    with pytest.raises(ResultsError, match=r"summary\.json: not a readable result"):
        read_tree(out)


def test_a_table_that_is_not_the_summarys_is_refused(out):
    frames = folder_of(out, "truth") / "frames.parquet"
    frames.write_bytes((folder_of(out, "empty") / "frames.parquet").read_bytes())
    with pytest.raises(ResultsError, match=r"frames\.parquet: does not belong"):
        read_tree(out)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("skybench-metrics/2", "skybench-metrics/0", "skybench-metrics/0"),
        ('"jobs": 1', '"jobs": "one"', r"provenance\.jobs"),
        ('"detections": "own"', '"detections": "shared"', "which its folder does not say"),
    ],
)
def test_a_summary_that_says_otherwise_is_refused(out, old, new, message):
    path = folder_of(out, "truth") / "summary.json"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ResultsError, match=message):
        read_tree(out)
