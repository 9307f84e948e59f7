"""The study of realism: statistics of agreement against hand-computed ones, its tables, and its page."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import PhotographError, ResultsError
from benchmark.report.formatting import number
from benchmark.report.marks import Mark
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.realism import agreement as measures
from benchmark.studies.realism import pairs
from benchmark.studies.realism.agreement import Outcomes, agreement_of
from benchmark.studies.realism.pairs import make_pairs
from benchmark.studies.realism.star_tables import pairs_of, star_tables
from benchmark.studies.realism.study import Study, frame_table, measure_tables, page, run_study, solver_table
from benchmark.twin.scene import read_scene
from generator.scenario.shipped import find_scenario

INF = math.inf
# Successes of a to d on photographs: 4, 3, 1, 0; on twins: 4, 2, 3, 0.
REAL = np.array([[1.0, 2, 1, 2], [1, 3, 2, INF], [INF, 50, 1, INF], [INF, INF, INF, INF]])
TWIN = np.array([[0.5, 1, 0.5, 1], [1, 3, INF, INF], [2, 1, 2, INF], [INF, INF, INF, 80]])
OUTCOMES = Outcomes(("a", "b", "c", "d"), REAL, TWIN)


def test_statistics_of_a_small_case() -> None:
    # Six pairs of solvers; only b and c swap: (5 - 1) / 6.
    assert measures.tau_success(OUTCOMES) == pytest.approx(4 / 6)
    assert measures.swapped_pairs(OUTCOMES) == 1
    # b fails the third twin alone; c fails the first two photographs alone: 13 of 16 agree.
    assert measures.same_outcome(OUTCOMES) == pytest.approx(13 / 16)
    # 8 successes of 16 on photographs and 9 on twins: one half agree by chance.
    assert measures.kappa(OUTCOMES) == pytest.approx((13 / 16 - 1 / 2) / (1 - 1 / 2))
    # Ratios of a: 2 four times; of b: 1 twice; of c: 1/2. The median of seven is 2.
    assert measures.error_ratio(OUTCOMES) == pytest.approx(2.0)


def test_medians_that_are_infinite_are_ties() -> None:
    # Lower medians: photographs 1, 2, 50, infinite; twins 0.5, 3, 2, infinite: one of six pairs swaps.
    assert measures.tau_error(OUTCOMES) == pytest.approx(4 / 6)
    # Medians 1, 2 (photographs) and 0.5, 3 (twins) of a and b; c has 50 and 2, d none.
    assert (agreement_of(OUTCOMES).n_finite, measures.tau_error_finite(OUTCOMES)) == (3, pytest.approx(1 / 3))
    equal = Outcomes(("a", "b"), np.full((2, 3), INF), TWIN[:2, :3])
    assert math.isnan(measures.tau_error(equal))
    assert math.isnan(measures.error_ratio(equal))


def test_equal_sets_agree_wholly() -> None:
    found = agreement_of(Outcomes(OUTCOMES.solvers, REAL, REAL))
    assert found.tau_success.value == pytest.approx(1.0)
    assert found.same_outcome.value == found.kappa.value == found.error_ratio.value == 1.0
    assert (found.error_ratio.low, found.error_ratio.high) == (1.0, 1.0)
    assert found.swapped == 0


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    # 40 frames and one solver; 60 intervals of 95 %: fewer than 47 hold the true share with a probability of 1e-6 at 95 %
    # coverage and of 2e-4 at 92 %.
    rng, held = np.random.default_rng(11), 0
    for _ in range(60):
        same = rng.uniform(size=40) < 0.7
        real = np.where(rng.uniform(size=40) < 0.5, 1.0, INF)
        twin = np.where(same, real, np.where(np.isfinite(real), INF, 1.0))
        found = measures._estimate(Outcomes(("a",), real[None], twin[None]), measures.same_outcome)
        held += found.low <= 0.7 <= found.high
    assert held >= 47


def measured(name: str) -> dict[str, object]:
    found = {"real": 10, "twin": 12, "spurious_real": 0.5, "spurious_twin": None}
    return {
        "photograph": name, "moon_altitude_deg": -3.2, "detections": {"celnav": found, "sep": found},
        "snr_ratio": 0.9, "flux_ratio": 1.1, "nearest_share_real": 0.3, "nearest_share_twin": 0.32,
        "sky_edges_deg": [10, 20, 90], "sky_ratio": [0.8, None], "noise_ratio": 1.0,
        "spectrum_ratio": [1.0, 1.0, 0.9, 0.8], "snr_by_magnitude": [], "width_by_angle": [],
    }  # fmt: skip


def test_the_page_says_what_was_found_and_what_is_undefined() -> None:
    names = ("001", "003", "005", "006")
    tables = (solver_table(OUTCOMES), frame_table(names, OUTCOMES), *measure_tables([measured(name) for name in names]))
    assert [row[0] for row in tables[0].rows] == ["a", "b", "c", "d"]
    assert tables[0].rows[2][3] == "1"  # c's wrong fix on a photograph
    assert tables[1].rows[2] == ("005", "3", "2", "1", "0")
    agreement = agreement_of(OUTCOMES)
    study = Study(names, "008.fits", OUTCOMES, agreement, tables, [], "skybench study realism", 1.0)
    text = page(study, Mark("skybench study realism", {"the study realism": "0" * 12}, {}), "A sentence.")
    assert "1 of 6 pairs" in text
    assert f"among the 3 solvers whose medians are finite on both {number(1 / 3)}" in text
    assert "008.fits" in text
    nothing = Outcomes(("a", "b"), np.full((2, 4), INF), np.full((2, 4), INF))
    study = Study(names, "008.fits", nothing, agreement_of(nothing), tables, [], "command", 1.0)
    assert "undefined" in page(study, Mark("command", {"the study realism": "0" * 12}, {}), "")
    assert "its interval tells little" in text


def binned_numbers(name: str) -> dict[str, object]:
    estimate = {"value": 8.0, "low": 7.0, "high": 9.0, "n": 30}
    ratio = {"value": 0.8, "low": 0.75, "high": 0.86, "n": 30}
    row = {"low": 4.0, "high": 5.0, "middle": 4.6, "real": estimate, "twin": estimate, "ratio": ratio}
    width = row | {"low": 15.0, "high": 30.0, "middle": 22.0}
    return measured(name) | {"snr_by_magnitude": [row], "width_by_angle": [width]}


def test_the_page_shows_the_stars_of_each_pair() -> None:
    numbers = [binned_numbers("001"), measured("003")]
    tables = star_tables(pairs_of(numbers))
    assert tables[0].rows == (("001", "0.80 (0.75 to 0.86), 30"), ("003", "-"))
    study = Study(("001", "003"), "003", OUTCOMES, agreement_of(OUTCOMES), tables, numbers, "command", 1.0)
    text = page(study, Mark("command", {"the study realism": "0" * 12}, {}), "")
    assert text.count("<figure>") == 2
    assert "SNR, 001" in text
    assert "Width of stars, 001" in text
    assert "0.80 (0.75 to 0.86), 30" in text
    assert "<figure>" not in page(
        dataclasses.replace(study, measures=[measured("003")]), Mark("command", {"the study realism": "0" * 12}, {}), ""
    )


def test_measurements_of_a_version_that_measured_less_are_made_again(tmp_path: Path) -> None:
    path = tmp_path / "001.json"
    assert pairs._kept_numbers(path) is None
    numbers = measured("001")
    path.write_text(json.dumps(numbers), encoding="utf-8")
    assert pairs._kept_numbers(path) == numbers
    del numbers["width_by_angle"]
    path.write_text(json.dumps(numbers), encoding="utf-8")
    assert pairs._kept_numbers(path) is None


def test_what_tells_nothing_is_refused(tmp_path: Path) -> None:
    scene = read_scene(find_scenario(Path("observatory_allsky")))
    silent = StudyProgress(lambda name, total: None, lambda: None)
    with pytest.raises(ResultsError, match="3 or more"):
        run_study(scene, [tmp_path / "a.fits"], tmp_path / "b.fits", ["skybench"], tmp_path, tmp_path, "", silent)
    with pytest.raises(PhotographError, match="judged too"):
        make_pairs(scene, [tmp_path / "a.fits"], tmp_path / "a.fits", tmp_path)
    for photographs, calibrated_on, mask, words in (
        ([tmp_path, tmp_path / "a.fits"], None, None, "give it alone"),
        ([tmp_path], tmp_path / "b.fits", None, "the records of .* state the camera"),
        ([tmp_path / "a.fits"], None, None, "need --calibrate-on FITS"),
        ([tmp_path / "a.fits"], tmp_path / "b.fits", tmp_path / "m.png", "is for a folder"),
    ):
        with pytest.raises(ResultsError, match=words):
            run_study(scene, photographs, calibrated_on, ["skybench"], tmp_path, tmp_path, "", silent, mask)


def test_the_page_of_a_dataset_names_what_is_left_out() -> None:
    study = Study(("a", "b"), None, OUTCOMES, agreement_of(OUTCOMES), (), [], "command", 1.0, left_out=("night_<7>",))
    text = page(study, Mark("command", {"the study realism": "0" * 12}, {}), "")
    assert "night_&lt;7&gt;" in text
    assert "celnav calibrate" not in text
