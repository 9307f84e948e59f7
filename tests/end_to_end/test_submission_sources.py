"""Sets packed from a task and from a dataset in shards: the truth of each, submitted, scores perfectly."""

from pathlib import Path

import pytest
import yaml
from small_scenes import BASE
from typer.testing import CliRunner
from unit.benchmark.stored import stored

from benchmark.cli.app import app
from benchmark.frames.frame_set import FrameSet
from benchmark.frames.opening import open_frames
from benchmark.frames.task_frames import FrameChoice
from benchmark.report.site.tree import read_tree
from benchmark.stats.frame_metrics import measure, read_frames
from benchmark.submit.csv_cells import csv_lines
from benchmark.submit.pack import withheld_names
from benchmark.submit.submission import FRAME_COLUMNS
from generator.dataset.generate import generate
from generator.dataset.layout import DatasetSpec
from generator.scenario.file import parse_scenario


def run(*arguments):
    result = CliRunner().invoke(app, ["bench", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.output


def submit_truth(truth: FrameSet, path: Path) -> Path:
    names = withheld_names(truth.frames)
    rows = [
        (names[f.frame_id], "fix", f.conditions.latitude_deg, f.conditions.longitude_deg, 1, 0, 1, 1, 1)
        for f in truth.frames
    ]
    path.write_text(csv_lines([FRAME_COLUMNS, *rows]), encoding="utf-8")
    return path


@pytest.mark.journey
def test_a_task(tmp_path):
    """One rendered frame, told with the errors of every level of the attitude task."""
    common = ("--frames", 1, "--data", tmp_path / "data")
    assert "11 frames in" in run("pack-test", "attitude", "--out", tmp_path / "set", *common)
    truth = open_frames("attitude", FrameChoice("test", 1, data=tmp_path / "data"))
    answers = submit_truth(truth, tmp_path / "answers.csv")
    run("check", answers, "--set", tmp_path / "set")
    output = run("score", answers, "--truth", "attitude@2", "--name", "mine", "--out", tmp_path / "out", *common)
    assert "11 frames, 11 fixes, 100 % within 200 km" in output
    (path,) = (tmp_path / "out" / "attitude@2" / "test" / "own").glob("mine-*/frames.parquet")
    frames = read_frames(path)
    assert measure(frames)["success_1km"].value == 1.0
    assert frames["condition"].tolist() == sorted(frames["condition"])
    # The worse the attitude is known, the less can be known of the position.
    assert frames["crlb_km"].is_monotonic_increasing
    assert frames["crlb_km"].iloc[-1] > 10 * frames["crlb_km"].iloc[0] > 0
    (result,) = stored(tmp_path / "out").values()
    assert result.provenance.frames.per_condition == 1
    # Another submission under the same name stands beside it, under a key of its own.
    answers.write_text(answers.read_text().replace(",1,1\n", ",0.5,1\n"))
    run("score", answers, "--truth", "attitude", "--name", "mine", "--out", tmp_path / "out", *common)
    assert [len(group) for group in read_tree(tmp_path / "out")] == [2]


@pytest.mark.parametrize("codec", ["png", "jxl"])
def test_a_dataset_in_shards(tmp_path, codec):
    tree = BASE | {"camera": BASE["camera"] | {"width": 120, "height": 80}, "stars": {"limiting_magnitude": 4.0}}
    text = yaml.safe_dump(tree)
    folder = tmp_path / "shards"
    generate(parse_scenario(text, "set.yaml"), text, folder, DatasetSpec(codec=codec))
    data = ("--data", tmp_path / "data")
    run("pack-test", folder, "--out", tmp_path / "set", *data)
    answers = submit_truth(open_frames(str(folder), FrameChoice(data=tmp_path / "data")), tmp_path / "answers.csv")
    assert {path.suffix for path in (tmp_path / "set").iterdir()} == {".png", ".json", ".csv"}
    output = run("score", answers, "--truth", folder, "--name", "mine", "--out", tmp_path / "out", *data)
    assert "1 frames, 1 fixes, 100 % within 10 km" in output
    assert CliRunner().invoke(app, ["bench", "pack-test", str(tmp_path / "no"), "--out", "x"]).exit_code == 2
