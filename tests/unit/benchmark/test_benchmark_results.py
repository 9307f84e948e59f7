import json
import math

import pyarrow.parquet as pq
import pytest
from unit.benchmark.fake_night import Mixed, Refusing, Truth, write_dataset

from benchmark.errors import ResultsError
from benchmark.frames.dataset import open_dataset
from benchmark.run.results import read_results, read_task_results
from benchmark.run.run import run_benchmark
from benchmark.stats.metrics import by_bortle, summarise


@pytest.fixture
def folder(tmp_path):
    return write_dataset(tmp_path / "night", (1, 8, None), per_class=2)


@pytest.fixture
def out(folder, tmp_path):
    frames = open_dataset(folder).frames
    solvers = [Mixed("mixed", frames), Refusing("empty", frames), Truth("truth", frames)]
    run_benchmark(folder, solvers, tmp_path / "out", progress=False)
    return tmp_path / "out"


def refuse_constant(token):
    raise AssertionError(f"{token} is not JSON")


def test_summaries_are_strict_json_with_provenance(out):
    for name in ("mixed", "empty", "truth"):
        text = (out / f"{name}.json").read_text()
        summary = json.loads(text, parse_constant=refuse_constant)
        assert summary["solver"] == name
        assert summary["definitions"] == "skybench-metrics/1"
        assert summary["provenance"]["dataset"] == "night"
        assert {"skybench", "python", "numpy"} <= set(summary["provenance"]["versions"])
        assert set(summary["provenance"]["machine"]) == {"cpu", "cores", "system"}
        assert [entry["bortle"] for entry in summary["by_bortle"]] == [1, 8, None]
        assert str(out) not in text
    assert json.loads((out / "empty.json").read_text())["overall"]["median_error_km"]["value"] is None
    assert json.loads((out / "empty.json").read_text())["reasons"] == {"too few stars": 6}


def test_what_is_read_is_what_was_judged(out):
    for result in read_results(out):
        assert repr(result.overall) == repr(summarise(result.scores))
        assert repr(list(result.bortle)) == repr(by_bortle(result.scores))
        assert len(result.scores) == 6


def test_tables_carry_units_and_provenance(out):
    table = pq.read_table(out / "truth.parquet")
    assert table.schema.field("error_km").metadata[b"unit"] == b"km"
    stamp = json.loads(table.schema.metadata[b"skybench"])
    assert (stamp["solver"], stamp["scenario_name"]) == ("truth", "fake night")
    assert table["stage_ms"].to_pylist()[0] == [("look up", 0.1)]
    assert table["cov_nn_km2"].to_pylist() == [0.02] * 6
    matches = pq.read_table(out / "truth-matches.parquet").to_pylist()
    assert {row["correct"] for row in matches if row["star_id"] is not None} == {True}


def test_frames_carry_what_statistics_sort_and_cluster_by(out):
    table = pq.read_table(out / "mixed.parquet")
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


def test_a_tasks_results_are_read_from_their_folders(out, tmp_path):
    folder = tmp_path / "results" / "bortle@1" / "dev" / "own" / "truth-0123456789ab"
    folder.mkdir(parents=True)
    for found, name in (("truth.parquet", "frames.parquet"), ("truth.json", "summary.json")):
        (folder / name).write_bytes((out / found).read_bytes())
    summary = json.loads((folder / "summary.json").read_text())
    summary["provenance"]["task"] = {"name": "bortle"}
    (folder / "summary.json").write_text(json.dumps(summary))
    (result,) = read_task_results(tmp_path / "results")
    assert (result.solver, result.overall.n_frames, result.detections) == ("truth", 6, ())
    folder.rename(folder.with_name("empty-0123456789ab"))
    with pytest.raises(ResultsError, match="result of 'truth'"):
        read_task_results(tmp_path / "results")
    with pytest.raises(ResultsError, match="no results of tasks"):
        read_task_results(tmp_path / "nowhere")


def test_refused_frames_have_no_error_in_the_table(out):
    table = pq.read_table(out / "empty.parquet")
    assert table["error_km"].null_count == 6
    assert set(table["status"].to_pylist()) == {"refused"}


def test_no_temporary_file_is_left(out):
    assert not [path for path in out.rglob("*") if path.name.endswith(".tmp")]


def test_results_of_another_dataset_are_kept_apart(out, tmp_path):
    other = write_dataset(tmp_path / "other", (4,))
    frames = open_dataset(other).frames
    with pytest.raises(ResultsError, match=r"empty\.json: is a result on another dataset.*--solver empty"):
        run_benchmark(other, [Truth("truth", frames)], out, progress=False)
    run_benchmark(other, [Truth("truth", frames)], tmp_path / "second", progress=False)
    for path in (tmp_path / "second").glob("truth*"):
        path.replace(out / path.name)
    with pytest.raises(ResultsError, match="different datasets"):
        read_results(out)


def test_damaged_results_are_refused_by_name(out, tmp_path):
    with pytest.raises(ResultsError, match="no results"):
        read_results(tmp_path / "nowhere")
    (out / "mixed-matches.parquet").unlink()
    with pytest.raises(ResultsError, match=r"mixed-matches\.parquet: missing"):
        read_results(out)
    (out / "empty.json").write_text("{}")
    with pytest.raises(ResultsError, match=r"empty\.json: not a readable result"):
        read_results(out)


def test_a_table_that_is_not_the_summarys_is_refused(out):
    (out / "truth.parquet").write_bytes((out / "empty.parquet").read_bytes())
    with pytest.raises(ResultsError, match=r"truth\.parquet: does not belong"):
        read_results(out)


def test_a_summary_of_another_definition_is_refused(out):
    path = out / "truth.json"
    path.write_text(path.read_text().replace("skybench-metrics/1", "skybench-metrics/0"))
    with pytest.raises(ResultsError, match="skybench-metrics/0"):
        read_results(out)
