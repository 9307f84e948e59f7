"""From catalogue to report on real frames: what the benchmark says of celnav on two rendered skies."""

import pytest
from small_scenes import small_scenario
from typer.testing import CliRunner
from unit.benchmark.stored import stored

from benchmark.cli.bench import app
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
    results = stored(chain / "out")
    assert set(results) == {"thesis-adaptive", "thesis-baseline"}
    assert not any((result.frames["status"] == "error").any() for result in results.values())
    adaptive = results["thesis-adaptive"].frames
    assert (adaptive["error_km"] < 10.0).all()
    assert adaptive["n_correct"].sum() > 0.95 * adaptive["n_matches"].sum()
    # Detections of rendered frames are stars of their truth table: image, truth and detector share one pixel grid. Among a
    # thousand are some of noise, and some whose star lies beyond the radius of a match.
    assert (adaptive["n_detections"] > 50).all()
    assert (adaptive["n_detected_stars"] >= 0.97 * adaptive["n_detections"]).all()


def test_the_report_shows_the_rendered_frames(chain):
    outcome = CliRunner().invoke(app, ["report", "--out", str(chain / "out")])
    assert outcome.exit_code == 0, outcome.output
    assert (chain / "out" / "site" / "index.html").is_file()
    (page,) = (chain / "out" / "site").glob("*-all-own.html")
    text = page.read_text(encoding="utf-8")
    assert "Success by Bortle class" in text
    assert "breaks at" not in text  # no task grades these frames
