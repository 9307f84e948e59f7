"""The truth as a contestant scores perfectly; an empty, a raising and a random one as they must."""

import math

import numpy as np
import pytest
from unit.benchmark.fake_night import Contestant, Raising, Random, Refusing, Truth, write_dataset
from unit.benchmark.stored import detections, stored

from benchmark.errors import DatasetError, ResultsError, UnknownSolverError
from benchmark.frames.dataset import open_dataset
from benchmark.protocol import Answer
from benchmark.run import engine
from benchmark.stats.intervals import wilson


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "night", (1, 2, None), per_class=3)


@pytest.fixture(scope="module")
def frames(folder):
    return open_dataset(folder).frames


def run(folder, out, *solvers, jobs=1):
    return {done.solver: done.summary for done in engine.run(folder, solvers, out, jobs=jobs)}


def test_truth_scores_perfectly(folder, frames, tmp_path):
    summary = run(folder, tmp_path, Truth("truth", frames))["truth"]
    assert (summary.n_frames, summary.n_fixes) == (9, 9)
    # Nine frames at three sites.
    assert (summary.recall.value, summary.recall.low, summary.recall.high) == (1.0, *wilson(3, 3))
    assert summary.median_error_km.value == summary.p90_error_km.value == 0.0
    assert summary.wrong_and_confident.value == 0.0
    assert summary.star_precision.value == summary.star_recall.value == 1.0
    # All 12 stars of a frame are bright enough for the detector, so recall of 1 is not one of nothing.
    frames = stored(tmp_path)["truth"].frames
    assert (frames["n_detected_stars"] >= 11).all()
    assert (frames["n_correct"] == frames["n_matches"]).all()
    assert summary.median_time_ms.value > 0.0


def test_refusing_scores_zero_with_infinite_errors(folder, frames, tmp_path):
    summary = run(folder, tmp_path, Refusing("empty", frames))["empty"]
    assert (summary.n_refused, summary.n_errors, summary.recall.value) == (9, 0, 0.0)
    assert summary.median_error_km.value == summary.p90_error_km.value == math.inf
    assert summary.wrong_and_confident.value == 0.0
    assert math.isnan(summary.star_precision.value)
    assert summary.star_recall.value == 0.0


def test_random_is_wrong_and_confident(folder, frames, tmp_path):
    summary = run(folder, tmp_path, Random("random", frames))["random"]
    # A cap of 10 km holds 6e-7 of the sphere: none of nine frames hits it but with probability 6e-6.
    assert (summary.recall.value, summary.wrong_and_confident.value) == (0.0, 1.0)
    # Random points lie within 1000 to 19 000 km of any place with probability 0.988; the median of nine all the more.
    assert 1000.0 < summary.median_error_km.value < 19_000.0
    assert summary.star_precision.value == summary.star_recall.value == 0.0


def test_raising_is_a_refusal_on_record_and_stops_nothing(folder, frames, tmp_path):
    summaries = run(folder, tmp_path, Raising("raising", frames), Truth("truth", frames))
    assert (summaries["raising"].n_errors, summaries["raising"].n_refused) == (9, 0)
    assert summaries["raising"].recall.value == 0.0
    assert summaries["truth"].recall.value == 1.0
    raising = stored(tmp_path)["raising"].frames
    assert set(raising["status"]) == {"error"}
    assert raising["reason"][0] == "error: RuntimeError: singular matrix <script>alert(1)</script>"


# Starts processes of its own.
@pytest.mark.journey
def test_processes_give_the_scores_of_one(folder, frames, tmp_path):
    solvers = Truth("truth", frames), Random("random", frames)
    run(folder, tmp_path / "one", *solvers)
    run(folder, tmp_path / "two", *solvers, jobs=2)
    ones, twos = stored(tmp_path / "one"), stored(tmp_path / "two")
    assert set(ones) == set(twos) == {"truth", "random"}
    for name, one in ones.items():
        assert (one.provenance.jobs, twos[name].provenance.jobs) == (1, 2)
        for column in ("frame_id", "error_km", "n_correct"):
            assert one.frames[column].tolist() == twos[name].frames[column].tolist()
        assert detections(one).equals(detections(twos[name]))


class Answering(Contestant):
    """Gives the answer it is made with."""

    answer = Answer(ok=True, lat_deg=0.0, lon_deg=0.0)

    def solve(self, detections, observation):
        return self.answer


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (Answer(ok=True), "impossible position"),
        (Answer(ok=True, lat_deg=math.nan, lon_deg=0.0), "impossible position"),
        (Answer(ok=True, lat_deg=91.0, lon_deg=0.0), "impossible position"),
        (Answer(ok=True, lat_deg=0.0, lon_deg=0.0, matches=np.zeros((1, 3), dtype=np.int64)), "matches of shape"),
        (Answer(ok=True, lat_deg=0.0, lon_deg=0.0, matches=np.zeros((1, 2))), "type float64"),
        (Answer(ok=True, lat_deg=0.0, lon_deg=0.0, matches=np.array([[9999, 1]])), "points to no detection"),
        (Answer(ok=True, lat_deg=0.0, lon_deg=0.0, matches=np.array([[-1, 1]])), "points to no detection"),
        (Answer(ok=True, lat_deg=0.0, lon_deg=0.0, matches=np.array([[0, 1], [0, 2]])), "matched twice"),
        (Answer(ok=True, lat_deg=0.0, lon_deg=0.0, cov_km2=np.full((2, 2), np.nan)), "covariance"),
        (Answer(ok=True, lat_deg=0.0, lon_deg=0.0, confidence=1.5), "confidence"),
    ],
)
def test_an_answer_that_makes_no_sense_is_an_error(folder, frames, tmp_path, answer, message):
    solver = Answering("nonsense", frames)
    object.__setattr__(solver, "answer", answer)
    assert run(folder, tmp_path, solver)["nonsense"].n_errors == 9
    assert stored(tmp_path)["nonsense"].frames["reason"].str.contains(message, regex=False).all()


class Blind(Truth):
    def detect(self, image):
        image[0, 0] = 0
        return super().detect(image)


def test_a_detector_that_fails_or_writes_to_the_image_is_an_error_of_its_users_only(folder, frames, tmp_path):
    summaries = run(folder, tmp_path, Blind("blind", frames, detector="own"), Truth("truth", frames))
    assert summaries["blind"].n_errors == 9
    assert summaries["truth"].recall.value == 1.0


def test_a_refusal_claims_no_matches(folder, frames, tmp_path):
    solver = Answering("shy", frames)
    object.__setattr__(solver, "answer", Answer(ok=False, reason="unsure", matches=np.array([[0, 1]])))
    summary = run(folder, tmp_path, solver)["shy"]
    assert math.isnan(summary.star_precision.value)


def test_bad_requests_are_refused_before_work(folder, frames, tmp_path):
    with pytest.raises(
        UnknownSolverError, match=r"'thesis-adaptiv' \(did you mean thesis-adaptive\?\); known: .*thesis-"
    ):
        run(folder, tmp_path, "thesis-adaptiv")
    with pytest.raises(ResultsError, match="once"):
        run(folder, tmp_path, Truth("a", frames), Truth("a", frames))
    with pytest.raises(ResultsError, match="at least one"):
        run(folder, tmp_path)
    with pytest.raises(ResultsError, match="letters"):
        run(folder, tmp_path, Truth("../evil", frames))
    with pytest.raises(ResultsError, match="jobs"):
        run(folder, tmp_path, Truth("a", frames), jobs=0)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_image_is_refused_before_work_and_nothing_is_written(tmp_path):
    folder = write_dataset(tmp_path / "night")
    frames = open_dataset(folder).frames
    frames[2].image_path.unlink()
    with pytest.raises(DatasetError, match=r"frame-00002\.png"):
        run(folder, tmp_path / "out", Truth("truth", frames))
    assert not (tmp_path / "out").exists()
