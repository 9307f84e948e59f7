"""Requests that cannot be met are refused before any frame is rendered, and answers without a reason are shown as such."""

import json
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from benchmark.cli import running, studies, submissions
from benchmark.cli.app import app
from benchmark.errors import ResultsError
from benchmark.studies.independence.study import FEWEST_FRAMES
from benchmark.submit.score import check_name


@pytest.mark.parametrize(
    "arguments",
    [
        ["independence", "--frames", "6"],
        ["realism", "1.fits", "2.fits", "3.fits", "--calibrate-on", "4.fits", "--scene", "observatory_allsky"],
    ],
)
def test_a_study_refuses_an_unknown_solver_before_it_renders(tmp_path, arguments):
    work = tmp_path / "work"
    folders = ["--work", str(work), "--out", str(tmp_path / "out")]
    run = CliRunner().invoke(app, ["study", *arguments, "--solver", "skybensh", *folders])
    assert run.exit_code == 2
    assert "unknown solver 'skybensh' (did you mean skybench?)" in run.output
    assert not work.exists()


def test_help_states_the_fewest_frames_that_the_study_takes():
    assert studies.INDEPENDENCE_FEWEST == FEWEST_FRAMES


def test_a_refusal_without_a_reason_is_shown_as_such():
    score = SimpleNamespace(status="refused", reason="", n_detections=0, time_ms=1.0)
    frame: Any = SimpleNamespace(frame_id="frame-00000", condition=None)
    outcome: Any = SimpleNamespace(score=score)
    assert running._answer(frame, outcome) == "frame-00000: refused: gives no reason; 0 detections, 1.00 ms"


def test_a_faulty_submission_is_one_json_document_for_score_as_for_check(tmp_path, capsys):
    file = tmp_path / "answers.csv"
    file.write_text("frame_id,status,lat_deg,lon_deg\nframe-1,fix,95,1\n", encoding="utf-8")
    for names in (None, frozenset({"frame-1"})):
        with pytest.raises(typer.Exit) as ended:
            submissions._read(file, None, names, as_json=True)
        assert ended.value.exit_code == submissions.EXIT_PROBLEMS
        document = json.loads(capsys.readouterr().out)
        assert (document["in_order"], document["problems"][0]["line"]) == (False, 2)


def test_a_submission_has_no_solver_s_name_in_other_letters():
    for name in ("skybench", "Skybench", "TETRA3RS"):
        with pytest.raises(ResultsError, match="is a solver of the benchmark"):
            check_name(name)
    check_name("skybench-of-mine")
