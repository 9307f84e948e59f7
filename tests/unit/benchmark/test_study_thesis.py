"""The replication: its frames, its sums and its page."""

import dataclasses
import json
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import celnav
from benchmark.cli.app import app
from benchmark.stats.intervals import Estimate, wilson
from benchmark.stats.paired_tests import mcnemar_exact
from benchmark.studies.common.centroid_frames import StarList, list_stars, make_frame, project
from benchmark.studies.common.contestants import Contestant, judge_detections
from benchmark.studies.common.page_model import Number, Outcome, Table, family, plain
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.common.records import Row, Rows, identified_test, near_test, write_rows
from benchmark.studies.common.series_plot import HEIGHT, RIGHT, WIDTH, Axis, Series, plot
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis import published as thesis
from benchmark.studies.thesis.answers_projection import swap_error_km
from benchmark.studies.thesis.centroids import DISTURBANCES, disturb, sites_of
from benchmark.studies.thesis.disturbed import CLEAR, SETTINGS, disturbed_scenario
from benchmark.studies.thesis.rendered import half_depth, study_scenario
from benchmark.studies.thesis.study import run_study
from benchmark.studies.thesis.tables import confidence_bins
from celnav.solver import SOLVERS
from generator.frame.plan import plan_frame
from generator.scenario.model import FrameSpec

SCENARIO = Path(__file__).parents[3] / "scenes" / "thesis_mag.yaml"


@pytest.fixture(scope="module")
def deep() -> list[StarList]:
    """Twelve sites of the thesis' set of magnitude 7."""
    scenario = study_scenario(SCENARIO, 12)
    place = thesis.LABELS_MAG.index(7.0)
    return [list_stars(scenario, 12 * place + n) for n in range(12)]


def row(contestant="a", error_km=1.0, n_matches=1, n_correct=1, confidence=0.5, depth=7.0, part="p", frame="f"):
    status = "fix" if math.isfinite(error_km) else "refused"
    return Row(part, depth, frame, contestant, status, "", error_km, n_matches, n_correct, confidence, 1.0, 2.0)


def test_what_the_thesis_reports_adds_up():
    """Its bins hold 200 frames and 57 failures, which are the 71.5 % of Table 1.1."""
    failures = sum(round(found.count * found.failures / 100) for found in thesis.TABLE_1_2)
    assert sum(found.count for found in thesis.TABLE_1_2) == thesis.N_FRAMES
    assert 100 * (1 - failures / thesis.N_FRAMES) == pytest.approx(thesis.TABLE_1_1[-1].recall)
    place = thesis.LABELS_MAG.index(thesis.TABLE_LABEL_MAG)
    assert (thesis.ADAPTIVE_RECALL[place], thesis.BASELINE_RECALL[place]) == (71.5, 39.0)


@pytest.mark.parametrize(("off_axis", "km"), [(5.0, 1.1), (9.3, 6.7), (10.6, 9.9), (20.0, 64.0), (30.0, 202.0)])
def test_the_projection_mix_up_has_the_predicted_size(off_axis, km):
    assert float(swap_error_km(off_axis)) == pytest.approx(km, rel=0.03, abs=0.05)


def test_projections_by_hand(deep):
    """45 degrees off the axis: f for a pinhole, 2 f tan 22.5 for the stereographic projection."""
    camera = make_frame(deep[0], 4.0).frame.observation.camera
    ray = np.array([[math.sin(math.pi / 4), 0.0, math.cos(math.pi / 4)], [0.0, 0.0, 1.0], [0.0, 1.0, -0.2]])
    pinhole, stereographic = (
        project(ray, camera, kind) - [camera.cx_px, camera.cy_px] for kind in ("pinhole", "stereographic")
    )
    assert pinhole[0] == pytest.approx([camera.f_px, 0.0])
    assert stereographic[0] == pytest.approx([2 * camera.f_px * math.tan(math.radians(22.5)), 0.0])
    assert np.abs(np.vstack((pinhole[1], stereographic[1]))).max() < 1e-9
    assert np.isnan(pinhole[2]).all()
    assert np.isfinite(stereographic[2]).all()


def test_a_swapped_frame_misplaces_one_star_by_the_formula(deep):
    """A star near the zenith, its name known: the fix is off by what the formula says, for a well placed star."""
    ratios = []
    for stars in deep:
        made = make_frame(stars, 3.5, "stereographic")
        camera = made.frame.observation.camera
        r = np.hypot(*(made.frame.truth.uv - [camera.cx_px, camera.cy_px]).T) / camera.f_px
        star = int(np.argmin(r))
        fix = celnav.fix_position(
            made.detections.uv[[star]],
            made.frame.truth.star_id[[star]],
            celnav.Camera("pinhole", camera.width, camera.height, f_px=camera.f_px),
            made.frame.observation.utc,
            made.frame.observation.R_cam,
        )
        site = made.frame.conditions
        a, b, c, d = np.radians([site.latitude_deg, site.longitude_deg, fix.lat_deg, fix.lon_deg])
        h = np.sin((c - a) / 2) ** 2 + np.cos(a) * np.cos(c) * np.sin((d - b) / 2) ** 2
        ratios.append(
            2 * 6371 * math.asin(math.sqrt(h)) / float(swap_error_km(math.degrees(2 * math.atan(r[star] / 2))))
        )
    assert np.median(ratios) == pytest.approx(1.0, abs=0.1)


def test_centroid_frames_hold_what_they_say(deep):
    made = make_frame(deep[0], 4.0, noise_px=0.5, seed=1)
    truth = made.frame.truth
    assert len(truth.star_id) == len(made.detections.uv) > 30
    offsets = made.detections.uv - truth.uv
    assert 0.35 < offsets.std() < 0.65
    assert make_frame(deep[0], 4.0, noise_px=0.5, seed=1).detections.uv == pytest.approx(made.detections.uv)
    assert made.detections.flux is not None
    assert (np.diff(made.detections.flux) <= 0).all()
    assert made.detections.flux.min() >= 10 ** (-0.4 * 4.0) * 0.999
    # The stereographic frame sees farther: the corner of a pinhole of 120 degrees looks 64 degrees from the axis.
    assert len(make_frame(deep[0], 4.0, "stereographic").detections) > len(made.detections)


def test_adaptive_recall_at_magnitude_seven_is_above_the_thesis(deep):
    found = []
    for stars in deep:
        made = make_frame(stars, 7.0, noise_px=0.3)
        (outcome,) = judge_detections(made.frame, made.detections, [Contestant("adaptive", SOLVERS[who.ADAPTIVE])])
        assert outcome.score.status != "error", outcome.score.reason
        found.append(outcome.score.error_km < 10.0)
    assert wilson(sum(found), len(found))[0] > 0.715


def test_the_literal_matcher_dies_of_the_mix_up(deep):
    contestant = [Contestant("literal", celnav.ddr_solver(who.LITERAL[who.LITERAL_ADAPTIVE]))]
    right = {}
    for projection in ("pinhole", "stereographic"):
        frames = [make_frame(stars, 3.0, projection, 0.1) for stars in deep]
        outcomes = [judge_detections(made.frame, made.detections, contestant)[0] for made in frames]
        right[projection] = [2 * o.score.n_correct > o.score.n_matches for o in outcomes]
    assert mcnemar_exact(right["pinhole"], right["stereographic"]).p < 0.05
    assert sum(right["stereographic"]) <= 2


def test_history_goes_only_where_it_is_passed(deep):
    made = make_frame(deep[0], 4.0)
    history = celnav.History()
    judge_detections(made.frame, made.detections, [Contestant("carried", SOLVERS[who.ADAPTIVE], history)], warm_up=True)
    assert len(history.entries) == 1


def test_disturbances(deep):
    made = make_frame(deep[0], 5.0)
    n = len(made.detections)
    assert len(disturb(made, "none").detections) == n
    assert 0.65 * n < len(disturb(made, "20 % missing").detections) < 0.95 * n
    assert len(disturb(made, "20 % false").detections) == n + round(0.2 * n)
    hot = disturb(made, "50 hot pixels").detections
    assert len(hot) == n + 50
    assert np.count_nonzero(hot.flux == made.detections.flux.max()) >= 50
    assert (disturb(made, "half clouded").detections.uv[:, 0] >= 539.5).all()
    assert len(DISTURBANCES) == 5
    with pytest.raises(ValueError, match="not one of"):
        disturb(made, "rain")


def test_sites_are_drawn_like_the_scenarios_own():
    sites = sites_of(study_scenario(SCENARIO, None), 3)
    assert len({stars.plan.spec.site.latitude_deg for stars in sites}) == 3
    assert all(stars.v_mag.max() <= 6.5 for stars in sites)


def test_disturbed_pictures_differ_in_their_disturbance_alone():
    """Sites, instants and cameras agree between settings, and the Moon that one of them has is full and up."""
    scenario = study_scenario(SCENARIO, None)
    made = {setting: disturbed_scenario(scenario, setting, 3) for setting in SETTINGS}
    for index in range(3):
        clear = made[CLEAR].frame(index)
        for setting, other in made.items():
            changed = {section for section in FrameSpec.model_fields if getattr(other.frame(index), section)
                       != getattr(clear, section)}  # fmt: skip
            assert changed == set(SETTINGS[setting])
        state = plan_frame(made["full Moon"], index).sky
        assert state.moon_altitude_deg > 5
        assert state.moon.phase_angle_deg < 10


def test_half_depth_by_hand():
    """Bins of 0.25 mag: all found to 5.0, six of ten in the bin to 5.25, four of ten in the next."""
    mags = np.concatenate((np.linspace(4.0, 4.999, 100), np.full(20, 5.1), np.full(20, 5.3)))
    found = np.concatenate((np.ones(100), np.arange(20) < 12, np.arange(20) < 8)).astype(bool)
    assert half_depth(mags, found) == 5.25
    assert half_depth(mags[:100], found[:100]) == pytest.approx(4.999)
    assert math.isnan(half_depth(mags, np.zeros(140, bool)))


def test_confidence_bins_by_hand():
    confidence = np.array([0.1, 0.4, 0.59, 0.6, 0.8, 1.0])
    errors = np.array([99.0, 1.0, 20.0, 3.0, 4.0, 50.0])
    found = confidence_bins(confidence, errors >= 10, errors)
    assert [count for count, _, _ in found] == [1, 2, 1, 2]
    assert [failures.value for _, _, failures in found] == [1.0, 0.5, 0.0, 0.5]
    assert found[1][1].value == pytest.approx(10.5)


def test_rows_answer_for_themselves(tmp_path):
    rows = Rows((row(), row(error_km=20.0), row(error_km=math.inf, n_matches=0, n_correct=0), row("b", depth=6.0)))
    mine = rows.of("p", "a")
    assert mine.near.tolist() == [True, False, False]
    assert mine.identified.tolist() == [True, True, False]
    assert mine.recall().value == pytest.approx(1 / 3)
    assert math.isinf(Rows(mine.rows[1:]).median_km().value)
    assert len(rows.of(depths=(6.0,))) == 1
    write_rows(tmp_path / "rows.parquet", rows.rows)
    table = pq.read_table(tmp_path / "rows.parquet")
    assert table["error_km"].to_pylist() == [1.0, 20.0, None, 1.0]
    assert table.schema.field("error_km").metadata == {b"unit": b"km"}


def test_comparisons_say_who_is_better():
    first, second = [True] * 12 + [False] * 3, [False] * 12 + [False] * 3
    one, other = family([("a", mcnemar_exact(first, second)), ("b", mcnemar_exact(second, second))])
    assert one.outcome is Outcome.BETTER
    assert family([("b", mcnemar_exact(second, first))])[0].outcome is Outcome.WORSE
    assert other.p_holm == 1.0
    assert other.outcome is Outcome.NO_DIFFERENCE
    assert "12 to 0 of 15" in one.text
    table = Table("t", "s", ("x",), ((Number(Estimate(math.inf, 1.0, math.inf, 3)),),))
    assert json.loads(json.dumps(plain(table), allow_nan=False))["rows"][0][0]["value"] is None


def test_only_rows_of_the_same_frames_are_paired():
    first = Rows(tuple(row(frame=f"f{n}") for n in range(8)))
    far = Rows(tuple(row(frame=f"f{n}", error_km=50.0, n_correct=0) for n in range(8)))
    assert near_test(first, far) == identified_test(first, far) == mcnemar_exact([True] * 8, [False] * 8)
    for other in (Rows(far.rows[::-1]), Rows(far.rows[1:])):
        for test in (near_test, identified_test):
            with pytest.raises(ValueError, match="in pairs"):
                test(first, other)


def test_plot_is_xml_and_escapes():
    axis = Axis("x < y & z", 0.0, 10.0, ((0.0, "0"), (10.0, "10")))
    log = Axis("km", 0.1, 100.0, ((1.0, "1"),), log=True)
    series = [
        Series("a & b", [1, 2, 3], [1.0, math.inf, 0.0], [0.5, 0.5, 0.0], [2.0, math.inf, math.inf], "diamond"),
        Series("<b>", [1, 2], [5.0, 500.0], shape="triangle", filled=False, line="none"),
    ]
    drawn = plot(series, axis, log, 'say "hi"')
    root = ET.fromstring(f"<figure>{drawn}</figure>")
    assert ["".join(node.itertext()) for node in root.iter("li")] == ["a & b", "<b>"]
    assert "x < y & z" in [node.text for node in root.iter("text")]
    shapes = [path.attrib["d"] for path in root.iter("path")]
    # The infinite point is left out; each series has a mark in the legend.
    assert sum(shape.endswith("z") and shape.count("L") == 3 for shape in shapes) == 2 + 1
    assert sum(shape.endswith("z") and shape.count("L") + shape.count("H") == 2 for shape in shapes) == 2 + 1
    # Intervals reach the ends of the axis where they lie beyond them: 0 below 0.1, an infinite one above 100.
    (bars,) = [shape for shape in shapes if shape.count("V") == shape.count("M") == 2]
    ends = [[float(one) for one in re.findall(r"[\d.]+", bar)][1:] for bar in bars.split("M")[1:]]
    (foot,) = [float(shape.split(" ")[1].split("H")[0]) for shape in shapes if shape.endswith(f"H{WIDTH - RIGHT}")][-1:]
    assert ends[1] == [foot, foot - HEIGHT]
    assert foot > ends[0][0] > ends[0][1] > foot - HEIGHT


@pytest.fixture(scope="module")
def small_study(tmp_path_factory):
    """Tiny pictures on which every solver may fail: the page has to say so, not break."""
    root = tmp_path_factory.mktemp("study")
    text = SCENARIO.read_text(encoding="utf-8")
    text = text.replace("width: 1080", "width: 216").replace("height: 720", "height: 144")
    text = text.replace("[8.0, 7.5, 7.0, 6.5, 6.0, 5.5, 5.0, 4.5, 4.0]", "[7.0, 5.0]")
    (root / "small.yaml").write_text(text, encoding="utf-8")
    steps = []
    progress = StudyProgress(lambda name, total: steps.append(name), lambda: None)
    study = run_study(root / "small.yaml", 2, None, root / "frames", root / "out", 2, "skybench <study>", progress)
    return root, study, steps


# A whole study: ten depths and eight disturbances with each of six contestants.
@pytest.mark.journey
def test_study_writes_page_numbers_and_rows(small_study):
    root, study, steps = small_study
    assert steps == ["rendering", "solving pictures", "disturbed pictures", "solving centroids"]
    page = (root / "out" / "index.html").read_text(encoding="utf-8")
    assert "skybench &lt;study&gt;" in page
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert len(page) < 2e6
    assert str(root) not in page
    numbers = json.loads((root / "out" / "study.json").read_text(encoding="utf-8"))
    assert [answer["key"] for answer in numbers["answers"]] == [f"H{n}" for n in range(1, 12)] + ["Label"]
    assert str(root) not in json.dumps(numbers)
    table = pq.read_table(root / "out" / "frames.parquet")
    assert table.num_rows == len(study.rows)
    assert [found.reason for found in study.rows.rows if found.status == "error"] == []
    assert all(answer.verdict for answer in study.answers)


# Of the same study.
@pytest.mark.journey
def test_study_takes_a_dataset_and_refuses_contradictions(small_study, tmp_path):
    root, _, _ = small_study
    runner = CliRunner()
    both = runner.invoke(app, ["study", "thesis", "--frames", "2", "--dataset", str(root / "frames")])
    assert both.exit_code == 2
    none = runner.invoke(app, ["study", "thesis", "--dataset", str(tmp_path), "--out", str(tmp_path / "out")])
    assert none.exit_code == 2
    assert "frame-*.json" in none.output


@pytest.mark.slow
def test_adaptive_recall_on_rendered_frames_of_magnitude_seven(tmp_path):
    from benchmark.studies.thesis.rendered import PART, solve_pictures
    from generator.frame.render import render_dataset

    scenario = study_scenario(SCENARIO, 12)
    tree = {**scenario.template, "stars": {"limiting_magnitude": 7.0}}
    render_dataset(dataclasses.replace(scenario, template=tree, axes=()), tmp_path / "frames")
    rows = Rows(solve_pictures(tmp_path / "frames", lambda: None).rows)
    assert rows.of(PART, who.ADAPTIVE).recall().low > 0.715
