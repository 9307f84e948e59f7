"""The study of independence: sizes of its displacements, its paired comparisons by hand, its page, and a refusal."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from benchmark.errors import ResultsError, TaskError
from benchmark.report.marks import Mark
from benchmark.studies.common.progress import StudyProgress
from benchmark.studies.independence.effects import effects_of
from benchmark.studies.independence.frames import displaced, joined_sets, perturbed_scenario, render_perturbed
from benchmark.studies.independence.perturbations import ARCSEC, PERTURBATIONS, raised, scattered, turned
from benchmark.studies.independence.study import Study, effect_tables, overview, page, run_study, summary_lines
from generator.frame.plan import plan_frame
from generator.scenario.file import load_scenario
from generator.scenario.shipped import find_scenario

SCENARIO = load_scenario(find_scenario(Path("independence_study")))
BY_KEY = {one.key: one for one in PERTURBATIONS}


@pytest.fixture(scope="module")
def plan():
    return plan_frame(perturbed_scenario(SCENARIO, None, 2), 1)


def moves_arcsec(plan, key):
    """Length of each star's displacement at mid-exposure, and its part towards the zenith, arcsec."""
    before, after = plan.middle.enu, displaced(plan, BY_KEY[key]).middle.enu
    up = np.radians(altitude_deg(after) - altitude_deg(before))
    return np.linalg.norm(after - before, axis=1) / ARCSEC, up / ARCSEC


def altitude_deg(enu):
    return np.degrees(np.arctan2(enu[:, 2], np.hypot(enu[:, 0], enu[:, 1])))


def test_displacements_have_the_sizes_that_are_said(plan):
    # Two axes of Gaussian scatter: the squared length over the variance has a mean of 2, to 5 sigma of its own.
    length, _ = moves_arcsec(plan, "catalogue-1arcsec")
    assert abs(np.square(length).mean() - 2.0) < 5 * 2 / math.sqrt(len(length))
    length, _ = moves_arcsec(plan, "catalogue")
    assert 0.018 < math.sqrt(np.square(length).mean() / 2) < 0.032
    length, up = moves_arcsec(plan, "refraction")
    # Refraction is 58.3 arcsec times the tangent of the zenith distance in the air of 0 C at sea level (Smart 1977).
    air, tangent = plan.spec.atmosphere, 1 / np.tan(np.radians(plan.middle.altitude_deg))
    expected = 5 + 0.03 * 58.3 * air.pressure_hpa / 1013.25 * 283.15 / (273.15 + air.temperature_c) * tangent
    assert up == pytest.approx(length, rel=1e-6)
    assert length == pytest.approx(expected, rel=0.02)
    length, _ = moves_arcsec(plan, "vertical")
    assert 20 < length.max() <= 36 + 1e-6
    length, _ = moves_arcsec(plan, "rotation")
    assert length.max() == pytest.approx(1.504, abs=0.02)
    length, _ = moves_arcsec(plan, "precession")
    assert 0.03 < length.max() < 0.08  # 0.3 arcsec a century, 18 to 26 years


def test_a_star_moves_alike_at_all_moments_and_stays_a_direction(plan):
    for key in ("catalogue-1arcsec", "refraction", "vertical", "rotation"):
        moved = displaced(plan, BY_KEY[key])
        assert np.linalg.norm(moved.directions, axis=2) == pytest.approx(1.0, abs=1e-12)
        first, last = (moved.directions[:, k] - plan.directions[:, k] for k in (0, -1))
        # The sky turns by 7.5 arcsec in the exposure: a displacement of 36 arcsec turns by a millionth.
        assert np.linalg.norm(first - last, axis=1).max() < 0.02 * ARCSEC
    assert displaced(plan, BY_KEY["moffat"]) is plan


def test_the_sky_turns_westward_with_more_ut1(plan):
    # 0.1 s later the same place sees stars further west: a star in the south moves from east to west.
    moved = displaced(plan, BY_KEY["rotation"]).middle.enu
    latitude = math.radians(plan.spec.site.latitude_deg)
    pole = np.array([0.0, math.cos(latitude), math.sin(latitude)])
    west = np.cross(plan.middle.enu, pole)
    assert (np.sum((moved - plan.middle.enu) * west, axis=1) > 0).all()


def test_rotations_and_lifts_by_hand():
    assert turned(np.array([[1.0, 0, 0]]), np.array([0, 0, 1.0]), math.pi / 2) == pytest.approx(np.array([[0, 1.0, 0]]))
    assert raised(np.array([[1.0, 0, 0]]), np.array([math.pi / 6])) == pytest.approx(
        np.array([[math.sqrt(0.75), 0, 0.5]])
    )
    still = np.array([[0.0, 0, 1.0]])
    assert scattered(still, 0.0, np.random.default_rng(1)) == pytest.approx(still)


def test_only_the_point_spread_of_a_lens_differs():
    changed = perturbed_scenario(SCENARIO, BY_KEY["coma-1"], 3)
    lens, plain = changed.frame(0).camera.psf, SCENARIO.frame(0).camera.psf
    assert (lens.diffraction.coma_waves, lens.diffraction.astigmatism_waves) == (1.0, 1.0)
    assert (plain.diffraction.coma_waves, lens.gaussian_sigma_px) == (0.0, plain.gaussian_sigma_px)
    assert perturbed_scenario(SCENARIO, BY_KEY["moffat"], 3).frame(0).camera.psf.diffraction is None
    assert changed.frame(1).site == SCENARIO.frame(1).site
    assert changed.frame(1).time == SCENARIO.frame(1).time
    with pytest.raises(TaskError, match="single raw frames"):
        perturbed_scenario(load_scenario(find_scenario(Path("demo"))), None, 2)


def frames(errors, sigma=1.0):
    """Frames with errors to the east, km, and a round covariance."""
    known = np.isfinite(errors)
    return pd.DataFrame(
        {
            "frame_id": [f"frame-{n}" for n in range(len(errors))], "site": [f"site {n}" for n in range(len(errors))],
            "status": np.where(known, "fix", "refused"), "error_km": np.where(known, np.abs(errors), np.nan),
            "error_east_km": np.where(known, errors, np.nan), "error_north_km": 0.0, "crlb_km": 0.5,
            "cov_ee_km2": sigma**2, "cov_en_km2": 0.0, "cov_nn_km2": sigma**2,
        }
    )  # fmt: skip


@pytest.fixture
def effects():
    errors = np.random.default_rng(5).normal(size=24)
    worse = np.where(np.arange(24) < 12, np.inf, 3 * errors)
    before = {"exact": frames(errors), "silent": frames(errors, math.nan)}
    return effects_of(before, {"vertical": {"exact": frames(3 * errors), "silent": frames(worse, math.nan)},
                               "moffat": before})  # fmt: skip


def test_effects_by_hand(effects):
    tripled = effects[0]
    assert (tripled.perturbation, tripled.solver) == ("vertical", "exact")
    assert tripled.bound_ratio.change.value == pytest.approx(3.0)
    assert tripled.bound_ratio.after.value == pytest.approx(3 * tripled.bound_ratio.before.value)
    assert tripled.nees.after.value == pytest.approx(9 * tripled.nees.before.value)
    assert tripled.nees.change.value == pytest.approx(8 * tripled.nees.before.value)
    east = np.random.default_rng(5).normal(size=24)
    limit = stats.chi2.ppf(0.95, 2)
    assert tripled.ellipse.after.value == pytest.approx(float((9 * east**2 <= limit).mean()))
    assert tripled.words == "error grows"
    silent = effects[1]
    assert silent.success.change.value == pytest.approx(-0.5)
    assert silent.words == "success falls, error grows"
    assert math.isnan(silent.nees.after.value)
    assert math.isnan(silent.ellipse.change.value)
    same = effects[2]
    assert (same.success.change.value, same.bound_ratio.change.value, same.words) == (0.0, 1.0, "none shown")


def test_the_page_has_no_covariances_of_who_returns_none(effects):
    chosen = (BY_KEY["vertical"], BY_KEY["moffat"])
    study = Study(24, chosen, effects, "skybench study independence")
    text = page(study, Mark("skybench study independence", {"the study independence": "0" * 12}, {}), "A sentence.")
    main, honest = effect_tables(study, chosen[0])
    assert [row[0] for row in main.rows] == ["exact", "silent"]
    assert [row[0] for row in honest.rows] == ["exact"]
    assert "vertical off by 0.01 deg" in text
    assert "median over identified fixes" in text
    assert "fixes within 10 km" not in text
    assert [len(row) for row in overview(study).rows] == [3, 3]
    assert summary_lines(study) == (
        "vertical off by 0.01 deg: exact: error grows; silent: success falls, error grows",
        "Moffat profile with beta 2.5: no effect shown",
    )


def test_too_few_frames_are_refused(tmp_path):
    with pytest.raises(ResultsError, match="6 or more"):
        run_study(
            find_scenario(Path("independence_study")), 2, ["skybench"], tmp_path, tmp_path, "command",
            StudyProgress(lambda name, total: None, lambda: None),
        )  # fmt: skip


def test_sizes_that_are_supplied_change_only_the_observations_of_the_same_frames(tmp_path):
    for key in ("refraction", "vertical"):
        assert BY_KEY[f"{key}-told"].frames_key == key
        assert not BY_KEY[key].told
    render_perturbed(SCENARIO, BY_KEY["refraction-told"], 1, tmp_path / "refraction")
    record = json.loads(next((tmp_path / "refraction").rglob("*.json")).read_text())
    assert record["scenario"]["name"] == f"{SCENARIO.name}-refraction"
    sets = {"refraction": tmp_path / "refraction", "refraction-told": tmp_path / "refraction"}
    joined = joined_sets(sets, {"refraction-told": BY_KEY["refraction-told"].told})
    silent, told = joined.frames
    assert silent.image_path == told.image_path
    assert (silent.observation.pressure_sigma_hpa, silent.observation.tilt_sigma_deg) == (0.0, 0.0)
    assert (told.observation.pressure_sigma_hpa, told.observation.tilt_sigma_deg) == (30.0, 5 / 3600)
    assert told.observation.utc == silent.observation.utc
    assert joined.facts.truth_sha256 != joined_sets(sets).facts.truth_sha256
