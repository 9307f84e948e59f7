"""From catalogue to report on real frames: what the benchmark says of celnav on two rendered skies."""

import pytest
from small_scenes import small_scenario
from typer.testing import CliRunner

from benchmark.cli.bench import app
from benchmark.run.results import read_results
from generator.frame.render import render_dataset


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    root = tmp_path_factory.mktemp("chain")
    scenario = small_scenario(camera__width=1080, camera__height=720, sky__bortle={"sweep": [2, 7]})
    render_dataset(scenario, root / "frames")
    arguments = ["run", str(root / "frames"), "--solver", "thesis-baseline", "--solver", "thesis-adaptive"]
    outcome = CliRunner().invoke(app, [*arguments, "--out", str(root / "out")])
    assert outcome.exit_code == 0, outcome.output
    return root


def test_the_adaptive_solver_finds_its_place_in_rendered_frames(chain):
    adaptive, baseline = read_results(chain / "out")
    assert (adaptive.solver, baseline.solver) == ("thesis-adaptive", "thesis-baseline")
    assert adaptive.overall.n_errors == baseline.overall.n_errors == 0
    assert adaptive.overall.recall.value == 1.0
    assert adaptive.overall.star_precision.value > 0.95
    # Detections of rendered frames are stars of their truth table: image, truth and detector share one pixel grid.
    for score in adaptive.scores:
        assert score.n_detections > 50
        assert score.n_detected_stars >= 0.98 * score.n_detections


def test_the_report_shows_the_rendered_frames(chain):
    outcome = CliRunner().invoke(app, ["report", "--out", str(chain / "out")])
    assert outcome.exit_code == 0, outcome.output
    page = (chain / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/webp;base64,") == 2
    assert "Bortle 7" in page
    assert 50_000 < len(page) < 5_000_000
