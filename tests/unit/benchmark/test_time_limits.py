"""A frame's limit is told to whoever searches by the clock, is shared by its tries, and is what all of them take together."""

from __future__ import annotations

import importlib.util
import io
import json
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from unit.benchmark.fake_night import write_dataset

from benchmark.frames.dataset import open_dataset
from benchmark.protocol import Answer
from benchmark.run.focal_retry import FOCAL_FACTORS, shares
from benchmark.run.sessions import PipeSession
from benchmark.solvers.definition import FOLDER, read_solver_folder
from benchmark.solvers.detected_points import Points
from benchmark.solvers.messages import request_of
from benchmark.solvers.ruststartracker.adapter import SEARCHES_S, RustStarTracker, search_time_s
from benchmark.solvers.serve import serve
from benchmark.stats.metrics import REFUSED

PROGRAM = """
import json, sys, time
for line in sys.stdin:
    asked = json.loads(line)
    if asked["type"] == "hello":
        answer = {"type": "hello", "protocol": "skybench-solver/1", "name": "slow", "version": "1"}
    else:
        print("told", asked["time_limit_s"], file=sys.stderr, flush=True)
        time.sleep(SLEEPS)
        answer = {"type": "fix", "frame_id": asked["frame_id"], "status": "refused", "reason": "searched"}
    print(json.dumps(answer), flush=True)
"""
SPEC = """name: slow
title: Refuses slowly
licence: MIT
version: "1"
command: [python, program.py]
focal_retries: true
"""


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    return open_dataset(write_dataset(tmp_path_factory.mktemp("data") / "night", (1,))).frames[0]


def asked(folder, frame, sleeps_s, limit_s):
    """The answer to a frame, and what each request told of the time; the first is the unscored one."""
    (folder / "program.py").write_text(PROGRAM.replace("SLEEPS", str(sleeps_s)))
    (folder / "solver.yaml").write_text(f"{SPEC}time_limit_s: {limit_s}\n")
    said: list[bytes] = []
    session = PipeSession(read_solver_folder(folder), said.append)
    try:
        session.start()
        answer = session.answer(frame, None)
    finally:
        session.close()
    return answer, [float(line.split()[1]) for line in b"".join(said).decode().splitlines()[1:]]


def test_each_try_is_told_its_share_of_what_is_left(tmp_path, frame):
    answer, told = asked(tmp_path, frame, 0.2, 10)
    assert answer.status == REFUSED
    assert told == [6.0, pytest.approx(4.9, abs=0.1), pytest.approx(9.6, abs=0.2)]
    assert len(told) == 1 + len(FOCAL_FACTORS)


def test_who_is_asked_once_may_take_all():
    assert shares(0) == (1.0,)
    assert shares(2)[-1] == 1.0


def test_shares_of_what_is_left_give_all_tries_after_the_first_the_same_time():
    left, given = 1.0, []
    for share in shares(26):
        given.append(share * left)
        left -= given[-1]
    assert left == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(given[1:], 0.4 / 26)


def test_all_tries_together_take_no_longer_than_the_frame_may(tmp_path, frame):
    answer, told = asked(tmp_path, frame, 0.7, 1)
    assert (answer.status, answer.answer.reason) == (REFUSED, "searched")
    assert answer.detect_ms + answer.solve_ms < 1200.0
    assert told == [0.6, pytest.approx(0.15, abs=0.1)]


class Patient:
    """A solver that says how long it may take."""

    name = version = detector = "patient"

    def __init__(self, limit_s=None):
        self.limit_s = limit_s

    def within(self, time_limit_s):
        return Patient(time_limit_s)

    def detect(self, image):
        return Points(np.zeros((0, 2)), None)

    def solve(self, detections, observation):
        return Answer(ok=False, reason=f"{self.limit_s:g} s")


def test_an_adapter_that_searches_by_the_clock_is_told_the_limit_too(frame):
    line = json.dumps(request_of(frame, None, frame.image_path, 4.5)).encode() + b"\n"
    replies = io.BytesIO()
    serve(Patient(), io.BytesIO(line), replies)
    assert json.loads(replies.getvalue())["reason"] == "4.5 s"


@pytest.mark.parametrize(("limit_s", "search_s"), [(10.0, 8.0), (6.0, 4.5), (2.0, 0.75), (0.3, 0.25)])
def test_ruststartracker_searches_as_long_as_its_table_leaves(limit_s, search_s):
    assert search_time_s(RustStarTracker().within(limit_s).ends_s) == search_s


def test_ruststartracker_that_nobody_times_ends_by_itself():
    assert search_time_s(None) == SEARCHES_S[-1]


def load_program(folder):
    spec = importlib.util.spec_from_file_location(f"program_{folder}", FOLDER / folder / "program.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Database:
    """What cedar-solve is asked for; its own raises IndexError where more than 150 centroids hold a pattern beyond them."""

    def __init__(self):
        self.database_properties = {"verification_stars_per_fov": 150}

    def solve_from_centroids(self, centroids, size, **settings):
        self.given, self.timeout_ms = np.asarray(centroids), settings["solve_timeout"]
        return {"RA": None}


def cedar_asked(count, limit_s):
    uv = np.column_stack((np.arange(count, dtype=float), np.arange(count, dtype=float)))
    camera = {"width": 640, "height": 480, "f_px": 1194.3, "fy_px": 1194.3, "cx_px": 319.5, "cy_px": 239.5}
    request = {"camera": camera, "detections": {"uv": uv.tolist()}, "image": None, "time_limit_s": limit_s}
    database = Database()
    reply = load_program("cedar-solve").answer(None, {30.0: database}, request)
    return database, uv, reply


def test_cedar_solve_gets_as_many_of_the_brightest_as_it_verifies_with():
    database, uv, reply = cedar_asked(200, 10.0)
    assert reply["reason"] == "no match"
    np.testing.assert_array_equal(database.given, uv[:150, ::-1] + 0.5)


@pytest.mark.parametrize(("limit_s", "search_s"), [(10.0, 9.0), (6.0, 5.4), (2.0, 1.7), (0.2, 0.0)])
def test_cedar_solve_searches_as_long_as_it_is_allowed_less_a_margin(limit_s, search_s):
    assert cedar_asked(8, limit_s)[0].timeout_ms == pytest.approx(1000.0 * search_s, abs=100.0)


def runs(process):
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_astrometry_net_ends_with_all_that_it_has_started(tmp_path):
    program = load_program("astrometry-net")
    code = (
        "import pathlib, subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        "pathlib.Path('child').write_text(str(child.pid)); time.sleep(60); raise SystemExit('ended by itself')"
    )
    assert program.run_within(5.0, [sys.executable, "-c", code], tmp_path) == ""
    child = int(Path(tmp_path / "child").read_text())
    # Who was killed is there until it is reaped, and on a busy machine for some moments before it is a zombie.
    until = time.perf_counter() + 20.0
    while runs(child) and time.perf_counter() < until:
        time.sleep(0.05)
    assert not runs(child)
    assert program.run_within(9.0, [sys.executable, "-c", "raise SystemExit('no index')"], tmp_path) == "no index"
