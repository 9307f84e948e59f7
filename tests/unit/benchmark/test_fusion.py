"""A fused contestant: another solver's positions of a sequence's frames, in the filter of skybench's own answers."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from unit.benchmark.fake_night import write_dataset
from unit.benchmark.test_sequence_tasks import KM_PER_DEG, PLACE, found_at, off_km, placed, tracked, turned_observation

from benchmark.errors import SolverError
from benchmark.frames.dataset import open_dataset
from benchmark.frames.frame_set import FrameSet, ungraded
from benchmark.judge.answers import Response, failure
from benchmark.protocol import Answer
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import outcomes, run
from benchmark.run.fused_session import FusedSession
from benchmark.run.sessions import SessionPool
from benchmark.solvers.celnav_solver import answer_of
from benchmark.solvers.definition import read_solver_folder
from benchmark.solvers.fusion import OWN_SIGMA_KM, Fusion
from benchmark.solvers.registry import known_solvers, solver_folder, solvers_by_themselves

PROGRAM = Path(__file__).parent / "programs" / "remembering.py"
SPEC = 'name: mine\ntitle: A program\nlicence: MIT\nversion: "1"\ncommand: [python, program.py, {way}]\n'
FUSED = "name: mine-fused\ntitle: The program, fused\nlicence: MIT\nfuses: ../mine\n"


def fused(extras, fusion=None, **changes):
    """Answers of a fusion to one answer after another, each off by an extra beside the vertical's error; None: a refusal."""
    fusion = Fusion() if fusion is None else fusion
    answers = []
    for index, extra in enumerate(extras):
        seen, east, north = turned_observation(0, index)
        alone = answer_of(found_at(east + (extra or 0.0), north, ok=extra is not None))
        answers.append(fusion.answer(dataclasses.replace(alone, **changes), seen))
    return answers


def test_others_answers_are_fused_as_skybenchs_are():
    extras = [0.0, 12.0, None, 4000.0, -7.0, 3.0, 0.0, 5.0]
    for other, own in zip(fused(extras), tracked(extras), strict=True):
        assert (other.lat_deg, other.lon_deg) == (own.lat_deg, own.lon_deg)
        assert (other.cov_km2 == own.cov_km2).all()
        assert other.confidence == own.confidence


@pytest.mark.parametrize("stated", [None, -np.eye(2), np.ones((2, 2))])
def test_what_states_no_covariance_or_an_impossible_one_gets_the_told_errors_and_a_few_kilometres(stated):
    answers = fused([0.0] * 8, cov_km2=stated)
    new, still = 0.3 * KM_PER_DEG, 0.5 * KM_PER_DEG
    assert answers[0].cov_km2 == pytest.approx(np.eye(2) * (new**2 + still**2 + OWN_SIGMA_KM**2), rel=0.01)
    # A full turn takes the part away that stands still.
    assert answers[7].cov_km2 == pytest.approx(np.eye(2) * (new**2 + OWN_SIGMA_KM**2) / 8, rel=0.02, abs=1.0)
    assert off_km(answers[0]) > 60
    assert off_km(answers[7]) < 2


class Scripted:
    """A session that gives one answer after another, and keeps what it was told."""

    def __init__(self, responses):
        self.responses, self.told = iter(responses), []

    def start(self):
        return "1"

    def answer(self, frame, shared):
        self.told.append(frame.observation)
        return next(self.responses)

    def close(self):
        self.told.append("closed")


def response(answer, status):
    return Response(answer, status, np.empty((0, 2)), np.empty(0), 1.0, 2.0, None)


def test_the_solver_is_asked_about_each_frame_by_itself_and_failures_stay_failures(dataset):
    frame = dataset.frames[0]
    seen = [turned_observation(0, index)[0] for index in range(4)]
    fix = response(answer_of(found_at(0.0, 0.0)), "fix")
    inner = Scripted([fix, failure("error: fell", 3.0), response(Answer(False, "too few"), "refused"), fix])
    session = FusedSession(inner)
    assert session.start() == "1"
    found = [session.answer(dataclasses.replace(frame, observation=one), None) for one in seen[:3]]
    assert [one.status for one in found] == ["fix", "error", "fix"]
    assert not found[1].answer.ok
    assert (found[2].answer.lat_deg, found[2].answer.reason) == (found[0].answer.lat_deg, "")
    assert found[0].solve_ms > 2.0
    # A frame of no sequence is the solver's own affair.
    alone = dataclasses.replace(seen[3], sequence=None)
    assert session.answer(dataclasses.replace(frame, observation=alone), None).answer is fix.answer
    session.close()
    assert inner.told.pop() == "closed"
    assert [one.sequence for one in inner.told] == [None] * 4
    assert [one.tilt_sigma_deg for one in inner.told] == pytest.approx([0.3] * 3 + [math.hypot(0.3, 0.5)])
    assert all((one.R_cam == told.R_cam).all() for one, told in zip(seen, inner.told, strict=True))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Three frames, said to be a sequence."""
    found = open_dataset(write_dataset(tmp_path_factory.mktemp("data") / "night", (1,), per_class=3))
    return dataclasses.replace(found, frames=tuple(placed(frame) for frame in found.frames))


def write_solvers(root, way="well", spec=FUSED):
    for name, text in (("mine", SPEC.format(way=way)), ("mine-fused", spec)):
        (root / name).mkdir(exist_ok=True)
        (root / name / "solver.yaml").write_text(text)
    (root / "mine" / "program.py").write_bytes(PROGRAM.read_bytes())
    return root / "mine-fused"


def test_a_program_of_ones_own_is_fused_by_a_folder_that_names_its_folder(dataset, tmp_path):
    contestant = contestant_of(write_solvers(tmp_path))
    assert (contestant.name, contestant.obstacle()) == ("mine-fused", "")
    pool = SessionPool(lambda: contestant.make_session(1), 1)
    try:
        judged = list(outcomes(dataset.frames, pool, "own", {}))
    finally:
        pool.close()
    # The program knows of no sequence. The camera does not turn, so that its own error grows less and the vertical's stays.
    assert [one.details.stage_ms["index"] for one in judged] == [-1.0] * 3
    assert [one.score.status for one in judged] == ["fix"] * 3
    variances = [one.details.cov_km2[2] for one in judged]
    still = (0.5 * KM_PER_DEG) ** 2
    assert variances == pytest.approx([still + OWN_SIGMA_KM**2 / n for n in (1, 2, 3)], rel=1e-4)
    facts = contestant.facts("1", "own")
    assert (facts.title, facts.time_limit_s, facts.isolation) == (
        "The program, fused",
        10.0,
        contestant_of(tmp_path / "mine").facts("1", "own").isolation,
    )


def test_its_revision_is_of_the_solver_and_of_the_filter(tmp_path, monkeypatch):
    folder = write_solvers(tmp_path)
    revision = read_solver_folder(folder).revision
    (folder / "solver.yaml").write_text(FUSED.replace("The program, fused", "Other words"))
    assert read_solver_folder(folder).revision == revision
    (tmp_path / "mine" / "weights.csv").write_text("1")
    assert read_solver_folder(folder).revision != revision
    (tmp_path / "mine" / "weights.csv").unlink()
    assert read_solver_folder(folder).revision == revision
    inner = read_solver_folder(tmp_path / "mine").revision
    monkeypatch.setattr("benchmark.solvers.definition.fusion_behaviour", OtherFilter)
    assert read_solver_folder(folder).revision != revision
    assert read_solver_folder(tmp_path / "mine").revision == inner


def test_frames_that_are_put_one_by_one_are_refused_before_any_work(dataset, tmp_path):
    folder = write_solvers(tmp_path)
    found, out = ungraded(dataset, "night"), tmp_path / "results"
    alone = tuple(
        dataclasses.replace(one, observation=dataclasses.replace(one.observation, sequence=None))
        for one in found.frames
    )
    with pytest.raises(
        SolverError, match=r"mine-fused: fuses .* those of night are put one by one; name mine, or a task"
    ):
        run(FrameSet(found.facts, alone), [folder], out)
    assert not list(out.rglob("*.json"))
    (done,) = run(found, [folder], out)
    assert done.summary.n_fixes == 3


class OtherFilter:
    modules = ()

    def __init__(self, sources):
        self.digest = "of another filter"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (FUSED + "adapter: celnav\n", "either adapter or command or fuses"),
        (FUSED + "time_limit_s: 60\n", "time_limit_s cannot be beside fuses"),
        (FUSED.replace("../mine", "../none"), r"mine-fused/solver\.yaml: fuses: no solver\.yaml in \.\./none"),
        (FUSED.replace("../mine", "."), "fuses another"),
    ],
)
def test_a_wrong_definition_is_refused(tmp_path, spec, message):
    with pytest.raises(SolverError, match=message):
        read_solver_folder(write_solvers(tmp_path, spec=spec))


def test_peers_and_the_learned_contestant_are_there_fused():
    rivals = ("cedar-solve", "learned", "ruststartracker", "tetra3rs", "zenith-fixer")
    found = sorted(set(known_solvers()) - set(solvers_by_themselves()))
    assert found == [f"{name}-fused" for name in rivals]
    assert [solver_folder(name).asked.name for name in found] == list(rivals)
    for name, asked in zip(found, rivals, strict=True):
        assert solver_folder(name).spec.licence == solver_folder(asked).spec.licence


def test_a_place_is_told_in_the_frames_of_the_filter():
    # Were east and north of the told errors exchanged, the answer at 40 deg of latitude would show it.
    seen = dataclasses.replace(turned_observation(0, 0)[0], utc_sigma_s=60.0)
    answer = Fusion().answer(Answer(True, "", *PLACE), seen)
    assert answer.cov_km2[0, 0] > 1.02 * answer.cov_km2[1, 1]
