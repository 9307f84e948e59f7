"""Contestants that refuse are asked again with other focal lengths, where their solver.yaml says so."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from unit.benchmark.fake_night import write_dataset

from benchmark.frames.dataset import open_dataset
from benchmark.run.focal_retry import FOCAL_FACTORS, focal_factors
from benchmark.run.sessions import PipeSession
from benchmark.solvers.definition import read_solver_folder
from benchmark.solvers.messages import reply_of
from benchmark.solvers.registry import known_solvers, solver_folder
from benchmark.stats.metrics import FIX, REFUSED
from celnav.camera import Camera
from celnav.problem import ToldSigmas
from celnav.sky.catalog import load_catalog, propagate

THESIS = ["adaptive", "baseline", "baseline+si", "baseline+si+pr", "catalogue-only"]
WITHOUT = ["skybench", *(f"thesis-{name}" for name in THESIS)]
PROGRAM = """
import json, sys
for line in sys.stdin:
    asked = json.loads(line)
    if asked["type"] == "hello":
        answer = {"type": "hello", "protocol": "skybench-solver/1", "name": "focal", "version": "1"}
    else:
        given = asked["detections"]
        answer = {"type": "fix", "frame_id": asked["frame_id"], "status": "refused"}
        answer["reason"] = f"{asked['camera']['f_px']:.1f}"
        if given is None:
            answer["detections"] = {"uv": [[1.0, 2.0], [3.0, 4.0]], "flux": [2.0, 1.0]}
        elif SOLVES(asked["camera"]):
            answer |= {"status": "fix", "lat_deg": float(len(given["uv"])), "lon_deg": asked["camera"]["f_px"]}
            answer["matches"] = [[1, 32349]]
    print(json.dumps(answer), flush=True)
"""


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    return open_dataset(write_dataset(tmp_path_factory.mktemp("data") / "night", (1,))).frames[0]


def asked(tmp_path, frame, solves, retries):
    (tmp_path / "program.py").write_text(PROGRAM.replace("SOLVES", f"(lambda camera: {solves})"))
    spec = 'name: focal\ntitle: Tells focal lengths\nlicence: MIT\nversion: "1"\ncommand: [python, program.py]\n'
    (tmp_path / "solver.yaml").write_text(spec + ("focal_retries: true\n" if retries else ""))
    session = PipeSession(read_solver_folder(tmp_path))
    try:
        session.start()
        return session.answer(frame, None)
    finally:
        session.close()


def test_the_first_focal_length_that_gives_a_fix_counts_with_the_detections_of_the_first(tmp_path, frame):
    told = frame.observation.camera.f_px
    found = asked(tmp_path, frame, f"abs(camera['fy_px'] / {told} - 1.13) < 1e-9", retries=True)
    assert found.status == FIX
    assert found.answer.lat_deg == 2.0
    assert found.answer.lon_deg == pytest.approx(1.13 * told)
    np.testing.assert_array_equal(found.uv, [[1.0, 2.0], [3.0, 4.0]])


def told(frame, **sigmas):
    return dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, **sigmas))


def test_an_open_focal_length_is_searched_as_widely_as_celnav_does(tmp_path, frame):
    """To three standard deviations, in steps within which a solver finds the stars."""
    wide = told(frame, focal_sigma=0.17)
    factors = sorted(focal_factors(wide.observation))
    assert max(factors) == pytest.approx(1 / min(factors))
    assert math.log(max(factors)) > 3 * 0.17 - 0.06
    assert max(later / earlier for earlier, later in itertools.pairwise(factors)) < 1.3
    expected = ToldSigmas(focal=0.17).focal_factors((0.88, 1.13), Camera.from_dict(wide.observation.camera.as_given()))
    assert focal_factors(wide.observation) == expected
    focal_px = frame.observation.camera.f_px
    found = asked(tmp_path, wide, f"camera['f_px'] > {1.5 * focal_px}", retries=True)
    assert found.status == FIX
    assert 1.5 * focal_px < found.answer.lon_deg < 1.8 * focal_px


def test_a_distortion_that_is_not_told_leaves_the_focal_length_open_too(frame):
    assert focal_factors(told(frame, distortion_sigma=0.3).observation) != FOCAL_FACTORS
    assert focal_factors(told(frame, focal_sigma=0.0001).observation) == FOCAL_FACTORS


def test_a_refusal_is_that_of_the_told_focal_length(tmp_path, frame):
    found = asked(tmp_path, frame, "False", retries=True)
    assert (found.status, found.answer.reason) == (REFUSED, f"{frame.observation.camera.f_px:.1f}")
    assert len(found.uv) == 2


def test_who_does_not_ask_for_it_is_asked_once(tmp_path, frame):
    assert asked(tmp_path, frame, "True", retries=False).status == REFUSED


def test_only_the_solver_that_searches_by_itself_and_the_thesis_which_gain_nothing_go_without():
    assert [name for name in known_solvers() if not solver_folder(name).asked.spec.focal_retries] == WITHOUT


def test_stars_may_be_matched_by_their_places(frame):
    stars = load_catalog()
    row = stars.rows_of([32349])
    place = propagate(stars.vectors[row], stars.motion[row], 2020.0 - stars.epoch_jyear[row])[0]
    ra, dec = np.degrees(np.arctan2(place[1], place[0])), np.degrees(np.arcsin(place[2] / np.linalg.norm(place)))
    message = {
        "type": "fix", "frame_id": frame.frame_id, "status": "fix", "lat_deg": 1.0, "lon_deg": 2.0,
        "detections": {"uv": [[1.0, 2.0], [3.0, 4.0]]}, "match_directions": [[1, ra, dec], [0, 10.0, 89.9]],
    }  # fmt: skip
    reply = reply_of(message, frame.frame_id, frame.observation, None)
    assert reply.answer.matches.tolist() == [[1, 32349]]
    for wrong in ([[2, ra, dec]], [[0.5, ra, dec]], [[0, ra]], "stars", [[0, float("nan"), 0.0]]):
        with pytest.raises(ValueError, match="match"):
            reply_of(message | {"match_directions": wrong}, frame.frame_id, frame.observation, None)
    with pytest.raises(ValueError, match="either"):
        reply_of(message | {"matches": [[0, 5]]}, frame.frame_id, frame.observation, None)
