"""The calibration study: its predictions against finite differences of the astrometry, its sums, its page."""

import dataclasses
import html
import json
import math
import re
from pathlib import Path

import erfa
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmark.judge.geodesy import radii_of_curvature_km
from benchmark.report.marks import Mark, find_marks
from benchmark.studies.calibration import bias as bias
from benchmark.studies.calibration import run as run
from benchmark.studies.calibration.bias import Estimator, View
from benchmark.studies.calibration.camera_by_gradient import Recovery
from benchmark.studies.calibration.chosen import subject_of
from benchmark.studies.calibration.faults import (
    EARTH_TURN_S,
    FAULTS,
    PRESSURE_HPA,
    Setting,
    celestial_pole,
    declared_truth,
    make_study_frame,
)
from benchmark.studies.calibration.gradient_summary import gradient_finding, gradient_table, nees_interval
from benchmark.studies.calibration.run import Shift
from benchmark.studies.calibration.study import Sizes, Study, page, run_study
from benchmark.studies.calibration.summary import (
    Effect,
    Shifts,
    effect_of_calibration,
    fault_findings,
    picture_table,
    size_tables,
    summary_table,
    thesis_case,
)
from benchmark.studies.common.centroid_frames import list_stars
from benchmark.studies.common.progress import StudyProgress
from generator.places.astrometry import Air, Site, apparent_places
from generator.places.times import Instant
from generator.scenario.file import load_scenario
from generator.scenario.projection import Projection

SCENARIO = Path(__file__).parents[3] / "scenes" / "calibration_study.yaml"
AIR = Air(PRESSURE_HPA, 10.0, 0.5)
N_STARS = 60
EXACT, FREE_HEADING = Estimator(), Estimator("vertical alone")
CALIBRATED = Estimator(free_sigmas=(0.03, 3.0, 3.0, 0.02, 0.02), noise_px=0.1)


class World:
    """The true forward model: ERFA's apparent places over any site and date, through a camera written here."""

    def __init__(self, index):
        self.stars = list_stars(load_scenario(SCENARIO), index)
        self.plan = self.stars.plan
        frame = make_study_frame(self.stars, self.plan.spec.camera, Setting(), noise_px=0.0)
        order = {star: row for row, star in enumerate(self.plan.stars.star_id.tolist())}
        rows = np.array([order[star] for star in frame.star_id[:N_STARS].tolist()])
        self.catalogue = self.plan.stars[rows]
        self.R_cam = frame.view.R_cam
        self.f_px = frame.view.lens.f_px
        self.view = View(
            frame.view.rays[:N_STARS], self.R_cam, frame.latitude_deg, frame.view.lens, frame.view.half_diagonal_px
        )
        self.lat, self.lon = frame.latitude_deg, frame.longitude_deg

    def rays(self, lat, lon, instant=None, air=AIR):
        """Directions in the camera, without any turn of it."""
        instant = self.plan.utc_mid if instant is None else instant
        return apparent_places(self.catalogue, Site(lat, lon), instant, self.plan.orientation, air).enu @ self.R_cam.T

    def project(self, rays, camera=(0.0, 0.0, 0.0, 0.0, 0.0), k1=0.0, stereographic=0.0):
        """Pixels from the middle: pinhole, with the study's five corrections, k1, and a part of the stereographic radius."""
        place = rays[:, :2] / rays[:, 2:]
        square = np.sum(place**2, axis=1)[:, None]
        cosine = rays[:, 2:] / np.linalg.norm(rays, axis=1, keepdims=True)
        place = place * (1 + k1 * square) * (1 + stereographic * (2 * cosine / (1 + cosine) - 1))
        q = self.f_px**2 * square / self.view.half_diagonal_px**2
        log_f, cx, cy, q1, q2 = camera
        return self.f_px * math.exp(log_f) * (1 + q1 * q + q2 * q**2) * place + [cx, cy]

    def solve(self, observed, told_rays, turn=(0.0, 0.0, 0.0), estimator=EXACT, camera=(0.0,) * 5, k1=0.0):
        """Position (east, north of the truth, km) by least squares on pixels or angles; `told_rays(lat, lon)` predicts."""
        east_km, north_km = radii_of_curvature_km(self.lat)

        def residuals(x):
            lat, lon = (
                self.lat + math.degrees(x[1] / north_km),
                self.lon + math.degrees(x[0] / east_km) / math.cos(math.radians(self.lat)),
            )
            heading = x[2] if estimator.horizon == "vertical alone" else 0.0
            # R_cam exp(turn) exp(heading) takes ENU to the told camera.
            declared = (
                self.R_cam @ Rotation.from_rotvec(turn).as_matrix() @ Rotation.from_rotvec([0, 0, heading]).as_matrix()
            )
            rays = told_rays(lat, lon) @ self.R_cam @ declared.T
            if estimator.weights == "angle":
                place = observed / self.f_px
                seen = np.column_stack((place, np.ones(len(place))))
                return (seen / np.linalg.norm(seen, axis=1, keepdims=True) - rays).ravel()
            values = np.array(camera)
            prior = np.empty(0)
            if estimator.free_sigmas:
                free = x[3:] * np.array(estimator.free_sigmas)
                values = values + free
                prior = x[3:]
            fit = (observed - self.project(rays, values, k1)).ravel() / estimator.noise_px
            return np.concatenate((fit, prior))

        n = 3 + len(estimator.free_sigmas)
        steps = [1.0, 1.0, 1e-3] + [0.01] * (n - 3)
        found = least_squares(residuals, np.zeros(n), x_scale=steps, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        return found.x[:2]


@pytest.fixture(scope="module", params=[0, 3])
def world(request):
    return World(request.param)


def derivative(measure, h):
    """Central difference."""
    return (measure(h) - measure(-h)) / (2 * h)


def close(found, predicted, rel=0.01):
    assert np.linalg.norm(found - predicted) < rel * np.linalg.norm(predicted), (found, predicted)


@pytest.mark.parametrize("estimator", [EXACT, FREE_HEADING], ids=lambda e: e.horizon)
def test_camera_faults_shift_as_predicted(world, estimator):
    """Focal length, principal point, k1 and projection: derivatives of a least-squares position by the fault's size."""
    seen, view = world.project(world.rays(world.lat, world.lon)), world.view
    declared = world.rays

    def bent(part):
        return world.project(world.rays(world.lat, world.lon), stereographic=part)

    faults = {
        "focal": (lambda h: world.solve(seen, declared, estimator=estimator, camera=(math.log1p(h), 0, 0, 0, 0)), 1e-4,
                  bias.focal_misfit(view, 1.0)),
        "centre": (lambda h: world.solve(seen, declared, estimator=estimator, camera=(0, h, 0, 0, 0)), 1e-2,
                   bias.centre_misfit(view, np.array([1.0, 0.0]))),
        "k1": (lambda h: world.solve(seen, declared, estimator=estimator, k1=h), 1e-5, bias.k1_misfit(view, 1.0)),
        "projection": (lambda h: world.solve(bent(h), declared, estimator=estimator), 1e-4, bias.projection_misfit(view)),
    }  # fmt: skip
    for measure, h, misfit in faults.values():
        close(derivative(measure, h), bias.position_bias_km(view, misfit, estimator))


@pytest.mark.parametrize("estimator", [EXACT, FREE_HEADING, CALIBRATED], ids=["exact", "vertical", "calibrated"])
def test_faults_of_horizon_and_sky_shift_as_predicted(world, estimator):
    """Tilt, heading, clock and refraction, also with the camera free."""
    seen, view, plan = world.project(world.rays(world.lat, world.lon)), world.view, world.plan

    def solve(declared=world.rays, turn=(0.0, 0.0, 0.0)):
        return world.solve(seen, declared, turn, estimator)

    def thinner(part):
        return dataclasses.replace(AIR, pressure_hpa=PRESSURE_HPA * (1 - part))

    h = 1e-5
    tilt = derivative(lambda s: solve(turn=(s, 0.0, 0.0)), h)
    close(tilt, bias.position_bias_km(view, bias.attitude_misfit(view, np.array([1.0, 0, 0])), estimator))
    heading = derivative(lambda s: solve(turn=(0.0, 0.0, s)), h)
    predicted = bias.position_bias_km(view, bias.attitude_misfit(view, np.array([0, 0, 1.0])), estimator)
    if estimator.horizon == "vertical alone":
        assert np.linalg.norm(heading) < 1e-3 * np.linalg.norm(tilt)
        assert np.linalg.norm(predicted) < 1e-9
    else:
        close(heading, predicted)
    clock = derivative(lambda s: solve(lambda lat, lon: world.rays(lat, lon, plan.utc_mid.plus(s))), 1.0)
    close(clock, bias.position_bias_km(view, bias.clock_misfit(view, 1.0), estimator))
    refraction = derivative(lambda part: solve(lambda lat, lon: world.rays(lat, lon, air=thinner(part))), 0.05)
    # Bennett's formula and ERFA's series differ by a part in a hundred.
    close(refraction, bias.position_bias_km(view, bias.refraction_misfit(view, PRESSURE_HPA, 10.0), estimator), 0.05)


def test_angular_weights_shift_as_predicted(world):
    seen = world.project(world.rays(world.lat, world.lon))
    angle = Estimator(weights="angle")

    def longer(part):
        return world.project(world.rays(world.lat, world.lon), (part, 0, 0, 0, 0))

    found = derivative(lambda h: world.solve(longer(h), world.rays, estimator=angle), 1e-4)
    close(found, -bias.position_bias_km(world.view, bias.focal_misfit(world.view, 1.0), angle))
    assert np.allclose(world.solve(seen, world.rays, estimator=angle), 0, atol=1e-6)


def test_wrong_epoch_shifts_as_predicted(world):
    """A year either way at the same Earth rotation angle; the stars' own motions are in the forward model alone."""
    seen, plan = world.project(world.rays(world.lat, world.lon)), world.plan

    def told(turns):
        days = turns * EARTH_TURN_S / 86400
        return Instant(plan.utc_mid.utc1, plan.utc_mid.utc2 + days)

    def measured(turns):
        return world.solve(seen, lambda lat, lon: world.rays(lat, lon, told(turns)))

    angle = erfa.era00(plan.utc_mid.utc1, plan.utc_mid.utc2 + plan.orientation.ut1_utc_s / 86400) + math.radians(
        world.lon
    )
    predicted = [
        bias.position_bias_km(
            world.view,
            bias.epoch_misfit(world.view, celestial_pole(plan.utc_mid), celestial_pole(told(turns)), angle),
            EXACT,
        )
        for turns in (366, -366)
    ]
    close(measured(366) - measured(-366), predicted[0] - predicted[1], 0.03)


def pinhole(f_px):
    return Projection("pinhole", f_px, f_px, 0.0, 0.0)


def view_towards_zenith(latitude_deg=45.0, f_px=300.0):
    """A ring of stars about the zenith and one in the middle."""
    angle = np.arange(12) / 12 * 2 * math.pi
    rays = np.column_stack((0.3 * np.cos(angle), 0.3 * np.sin(angle), np.ones(12)))
    rays = np.vstack((rays / np.linalg.norm(rays, axis=1, keepdims=True), [0.0, 0.0, 1.0]))
    R_cam = np.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])
    return View(rays, R_cam, latitude_deg, pinhole(f_px), 500.0)


def test_sizes_that_everybody_knows():
    view = view_towards_zenith(60.0)
    # A second is 464 m at the equator (Bowditch: 15 arcsec, a quarter of a mile), half of that at 60 degrees; west.
    east, north = bias.position_bias_km(view, bias.clock_misfit(view, 1.0), FREE_HEADING)
    assert east == pytest.approx(-0.4651 * math.cos(math.radians(60)), rel=3e-3)
    assert abs(north) < 1e-9
    # A minute of arc is a nautical mile.
    tilt = bias.attitude_misfit(view, np.radians([1 / 60, 0.0, 0.0]))
    assert np.linalg.norm(bias.position_bias_km(view, tilt, FREE_HEADING)) == pytest.approx(1.852, rel=5e-3)
    # Refraction and focal length move a symmetric zenith frame nowhere.
    for misfit in (bias.refraction_misfit(view, PRESSURE_HPA, 10.0), bias.focal_misfit(view, 0.01)):
        assert np.linalg.norm(bias.position_bias_km(view, misfit, EXACT)) < 1e-9
    # The Nautical Almanac's table of altitude corrections for stars: 5.3' at 10 degrees, 1.0' at 45.
    for altitude_deg, arcmin in ((10.0, 5.3), (45.0, 1.0)):
        z = math.radians(90 - altitude_deg)
        star = View(np.array([[math.sin(z), 0.0, math.cos(z)]]), view.R_cam, 0.0, pinhole(1.0), 1.0)
        lift = np.linalg.norm(bias.refraction_misfit(star, 1010.0, 10.0).shift_px) * math.cos(z) ** 2
        assert math.degrees(lift) * 60 == pytest.approx(arcmin, abs=0.1)


def test_the_pole_moves_twenty_arcseconds_a_year():
    poles = [celestial_pole(Instant.parse(f"{year}-01-01T00:00:00Z")) for year in (2001, 2020)]
    # 19 years hold nearly one period of the main nutation term (18.6 years).
    assert math.degrees(poles[1][0] - poles[0][0]) * 3600 / 19 == pytest.approx(20.04, abs=0.2)


def test_the_mix_up_is_of_third_order():
    angles = np.radians([2.0, 5.0, 10.0])
    view = View(np.column_stack((np.sin(angles), np.zeros(3), np.cos(angles))), np.eye(3), 0.0, pinhole(300.0), 500.0)
    shift = bias.projection_misfit(view).shift_px[:, 0]
    np.testing.assert_allclose(shift, -300.0 * angles**3 / 4, rtol=0.02)


def test_solver_shifts_as_predicted_and_calibrates_it_away():
    """The real solver on three sites, for each fault at its typical size but the projection, which is not of first order."""
    sites = [list_stars(load_scenario(SCENARIO), index) for index in range(3)]
    for fault in FAULTS:
        if fault.key == "projection":
            continue
        for stars in sites:
            frame = make_study_frame(stars, stars.plan.spec.camera, fault.setting(fault.typical))
            names = (run.DECLARED, run.CALIBRATED)
            right = {name: run.offset_km(frame, name, declared_truth(frame)) for name in names}
            declared, calibrated = run.shifts_of(run.CENTROIDS, fault, fault.typical, frame, names, right)
            assert declared.along == pytest.approx(1.0, abs=0.15), fault.key
            if fault.key in ("focal", "centre", "k1"):
                assert calibrated.moved_km < 0.1 * declared.moved_km, fault.key
            else:
                assert calibrated.along == pytest.approx(1.0, abs=0.15), fault.key


def shift(moved, error=1.0, faultless=0.1, predicted=1.0):
    return Shift("centroids", "f", 1.0, 0, "a", moved, 0.0, predicted, 0.0, error, faultless)


def test_verdicts_by_hand():
    def many(moved):
        return Shifts(tuple(shift(moved * (1 + n / 1000)) for n in range(20)))

    assert effect_of_calibration(many(10.0), many(0.5)) is Effect.CORRECTED
    # Less than three times the error without a fault.
    assert effect_of_calibration(many(1.0), many(0.25)) is Effect.CORRECTED
    assert effect_of_calibration(many(1.0), many(2.0)) is Effect.WORSE
    assert effect_of_calibration(many(1.0), many(1.001)) is Effect.UNCHANGED
    assert effect_of_calibration(many(10.0), many(5.0)) is Effect.PARTLY_CORRECTED


def test_shifts_answer_for_themselves():
    shifts = Shifts((shift(0.9), shift(1.1), shift(math.nan, error=math.inf)))
    assert shifts.rows[0].along == pytest.approx(0.9)
    assert math.isinf(shifts.rows[2].moved_km)
    assert shifts.moved_km().value == pytest.approx(1.1)
    assert shifts.along().n == 2
    assert shifts.fixed().value == pytest.approx(2 / 3)
    assert len(shifts.of("centroids", "f", "b").rows) == 0


def test_interval_of_squared_errors():
    """chi^2 with 50 degrees: 32.4 and 71.4 (Abramowitz and Stegun, table 26.8)."""
    assert nees_interval(10) == pytest.approx((32.357, 71.420), abs=1e-2)


SUBJECT = subject_of(load_scenario(SCENARIO))
LEFT = {"focal": 0.05, "centre": 0.05, "clock": 2.0, "heading": 5.0}
"""Shift, km, that self-calibration leaves of 2 km; 1 km of the others."""


def made_by_hand():
    """A study of twenty sites: a solver that moves as predicted but for refraction, and recoveries at their bound."""
    rows = []
    for fault in FAULTS:
        for size in fault.sizes:
            for name in run.ON_CENTROIDS:
                moved = LEFT.get(fault.key, 1.0) if name == run.CALIBRATED else 2.0
                predicted = 4.0 if fault.key == "refraction" else 2.0
                rows += [
                    Shift(
                        run.CENTROIDS, fault.key, size, site, name, moved + site / 1e4, 0.0, predicted, 0.0, 1.0, 1e-3
                    )
                    for site in range(20)
                ]
    for number, name in enumerate(run.ON_PICTURES):
        for key in (*(fault.key for fault in FAULTS if fault.key != "projection"), run.THESIS_CASE):
            errors = [5.0 if site < number else 40.0 if site == 3 else math.inf for site in range(4)]
            rows += [
                Shift(run.PICTURES, key, 1.0, site, name, 2.0, 0.0, 2.0, 0.0, error, 1e-3)
                for site, error in enumerate(errors)
            ]
    sigma = np.array([1e-5, 1e-4, 1e-5, 1e-5, 1e-5])
    recovered = tuple(
        Recovery(n, 100 * sigma, sigma * [1, -1, 1, 2, 1], sigma, 8.0, 20 + n, (3.0, 0.1, 0.01)) for n in range(3)
    )
    return Shifts(tuple(rows)), recovered


def test_findings_by_hand():
    shifts, recovered = made_by_hand()
    found = fault_findings(shifts)
    assert found.n_faults == len(FAULTS) == len(found.as_predicted) + 1
    assert not any("Refraction" in title for title in found.as_predicted)
    assert found.by_effect[Effect.CORRECTED] == ("Focal length too long (0.3 %)", "Principal point off (1 px)")
    assert found.by_effect[Effect.UNCHANGED] == ("Clock fast (10 s)",)
    assert found.by_effect[Effect.WORSE] == ("Heading off (0.1 deg)",)
    assert len(found.by_effect[Effect.PARTLY_CORRECTED]) == len(FAULTS) - 4
    case = thesis_case(shifts)
    # One solver after the other has one near position more, and all have a far one.
    assert case.fixed == {run.DECLARED: 1, run.CALIBRATED: 3, run.THESIS: 4}
    assert (case.n_pictures, case.most_near) == (4, 4)
    gradient = gradient_finding(recovered)
    assert (gradient.worst_ratio, gradient.nees, gradient.steps) == (pytest.approx(2.0), 24.0, 21.0)
    assert gradient.inside
    assert not gradient_finding([dataclasses.replace(one, nees=20.0) for one in recovered]).inside


def test_page_says_the_findings():
    shifts, recovered = made_by_hand()
    tables = (
        summary_table(shifts),
        picture_table(shifts, SUBJECT.text),
        gradient_table(recovered),
        *size_tables(shifts),
    )
    study = Study(SUBJECT, Sizes(20, 4, 3), shifts, recovered, tables, "skybench <study>", 1.0)
    mark = Mark(study.command, {"the study calibration": None})
    sentence = "Measured before revisions of the study calibration were recorded."
    made = page(study, mark, sentence)
    assert [(one.mark, one.sentence) for one in find_marks(made)] == [(mark, sentence)]
    text = re.sub(r"\s+", " ", html.unescape(re.sub("<[^>]+>", "", made)))
    assert "within 10 % of the first-order prediction for 8 of 9 faults" in text
    assert "Corrected: Focal length too long (0.3 %); Principal point off (1 px)." in text
    assert "Worse: Heading off (0.1 deg)." in text
    solved = "Of 4 pictures, 1 are solved with camera as declared, 3 are solved with self-calibration"
    assert solved in text
    assert "4 are solved with thesis-adaptive; at most 4 by one solver within 10 km." in text
    assert "errors of at most 2.00 times their Cramér-Rao bound on 3 pictures" in text
    assert "add up to 24.0, within the range 6.3 to 27.5" in text
    assert "Command: skybench <study>" in text


@pytest.fixture(scope="module")
def small_study(tmp_path_factory):
    root = tmp_path_factory.mktemp("calibration")
    steps = []
    progress = StudyProgress(lambda name, total: steps.append((name, total)), lambda: None)
    study = run_study(SCENARIO, Sizes(2, 1, 2), root / "frames", root / "out", "skybench <study>", progress)
    return root, study, steps


@pytest.mark.slow
def test_study_writes_page_numbers_and_rows(small_study):
    root, study, steps = small_study
    assert [name for name, _ in steps] == ["faults on centroids", "faults on pictures", "camera by gradient"]
    written = (root / "out" / "index.html").read_text(encoding="utf-8")
    assert "skybench &lt;study&gt;" in written
    assert "http://" not in written.replace("http://www.w3.org/2000/svg", "")
    assert str(root) not in written
    numbers = json.loads((root / "out" / "study.json").read_text(encoding="utf-8"))
    assert len(numbers["tables"]) == 3 + len(FAULTS)
    table = pq.read_table(root / "out" / "shifts.parquet")
    assert table.num_rows == len(study.shifts.rows)
    assert table.schema.field("east_km").metadata == {b"unit": b"km"}
    assert pq.read_table(root / "out" / "gradient.parquet").num_rows == 2
