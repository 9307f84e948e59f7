"""Programs under test that misbehave cost themselves the frame and nobody else anything."""

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
import pytest
from unit.benchmark.fake_night import write_dataset

from benchmark.errors import SolverError
from benchmark.frames.dataset import open_dataset
from benchmark.protocol import SIGMAS
from benchmark.run.contestants import contestant_of
from benchmark.run.engine import outcomes
from benchmark.run.sessions import SessionPool
from benchmark.run.shared_detections import KeptDetections
from benchmark.solvers.definition import SolverFolder, SolverSpec, read_solver_folder
from benchmark.solvers.detected_points import Points
from benchmark.solvers.messages import reply_of, request_of
from benchmark.solvers.program import Limits, ProgramFailedError, ProgramSession, _environment
from benchmark.solvers.registry import known_solvers, make_solver, solver_folder

ROOT = Path(__file__).parents[3]
PROGRAM = Path(__file__).parent / "programs" / "misbehaving.py"
LIMITS = Limits(time_s=1.0, memory_mib=600, start_s=20.0)


def session(way, limits=LIMITS):
    return ProgramSession([sys.executable, str(PROGRAM), way], PROGRAM.parent, limits)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return open_dataset(write_dataset(tmp_path_factory.mktemp("data") / "night", (1, 2, 3))).frames


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("hang", "no answer within 1 s"),
        ("crash", r"exit status 7 \(cannot go on: the stars are wrong\)"),
        ("abort", "ended by signal SIGABRT"),
        ("garbage", "not JSON: b'Solved! lat = 48'"),
        ("list", "no object"),
        ("deep", "not JSON"),
        ("flood", "more than 16000000 bytes"),
        ("flood of lines", "not JSON"),
        ("memory", "MemoryError"),
        ("memory of children", "held more than 600 MiB with the processes that it started"),
        ("files in memory", "held more than 600 MiB"),
        ("many processes", "more than 64 processes"),
    ],
)
def test_a_misbehaving_program_is_killed_and_named(frames, way, message):
    limits = LIMITS if way == "hang" else Limits(time_s=30.0, memory_mib=600, start_s=20.0)
    with session(way, limits) as running:
        running.start()
        with pytest.raises(ProgramFailedError, match=message) as caught:
            running.ask(request_of(frames[0], None, frames[0].image_path))
        assert caught.value.time_ms >= 0.0
        assert not running.running


def test_pages_that_processes_share_count_once(frames):
    """Three children of a process of 300 MB have 1.2 GB of resident memory in all, and 300 MB of memory."""
    with session("shared memory", Limits(time_s=30.0, memory_mib=600, start_s=20.0)) as running:
        running.start()
        exchange = running.ask(request_of(frames[0], None, frames[0].image_path))
    assert exchange.message["lat_deg"] == 30.0


def test_a_file_in_memory_that_is_mapped_too_counts_once(frames):
    """400 MB, held open and mapped."""
    with session("mapped file in memory", Limits(time_s=30.0, memory_mib=600, start_s=20.0)) as running:
        running.start()
        exchange = running.ask(request_of(frames[0], None, frames[0].image_path))
    assert exchange.message["lat_deg"] == 48.0


def test_children_are_killed_too(frames, tmp_path, monkeypatch):
    monkeypatch.setenv("SOLVER_CHILD_PID_FILE", str(tmp_path / "pid"))
    with session("hang with a child") as running:
        running.start()
        with pytest.raises(ProgramFailedError, match="no answer"):
            running.ask(request_of(frames[0], None, frames[0].image_path))
    assert is_dead(int((tmp_path / "pid").read_text()))


def test_nothing_is_left_when_the_benchmark_is_killed(frames, tmp_path, monkeypatch):
    monkeypatch.setenv("SOLVER_CHILD_PID_FILE", str(tmp_path / "pid"))
    code = (
        "import json, sys; from pathlib import Path; from benchmark.solvers.program import Limits, ProgramSession\n"
        "session = ProgramSession([sys.executable, sys.argv[1], 'hang with a child'], Path('.'), Limits(time_s=60))\n"
        "session.start(); session.ask(json.loads(sys.argv[2]))"
    )
    asked = json.dumps(request_of(frames[0], None, frames[0].image_path))
    with subprocess.Popen([sys.executable, "-c", code, str(PROGRAM), asked], cwd=ROOT) as benchmark:
        wait_until(lambda: (tmp_path / "pid").is_file() and (tmp_path / "pid").read_text())
        started = psutil.Process(benchmark.pid).children(recursive=True)
        assert len(started) == 3  # the guardian, the program and its child
        benchmark.kill()
    wait_until(lambda: all(is_dead(process.pid) for process in started))


def test_a_program_gets_no_variable_that_could_be_a_secret(monkeypatch):
    monkeypatch.setenv("API_TOKEN", "secret")
    monkeypatch.setenv("SOLVER_THREADS", "3")
    given = _environment()
    assert "API_TOKEN" not in given
    assert (given["SOLVER_THREADS"], given["PATH"]) == ("3", os.environ["PATH"])


def wait_until(there, limit_s=20.0):
    deadline = time.monotonic() + limit_s
    while not there():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def is_dead(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def test_words_on_standard_error_do_no_harm(frames):
    with session("flood of errors") as running:
        running.start()
        exchange = running.ask(request_of(frames[0], None, frames[0].image_path))
    assert exchange.message["lat_deg"] == 48.0
    assert exchange.time_ms > 0.0
    assert 1.0 < exchange.peak_memory_mib < 600.0


def test_what_is_printed_beyond_the_answer_is_a_failure_of_the_next_frame(frames):
    with session("chatter") as running:
        running.start()
        running.ask(request_of(frames[0], None, frames[0].image_path))
        with pytest.raises(ProgramFailedError, match="more than its answer"):
            running.ask(request_of(frames[1], None, frames[1].image_path))


@pytest.mark.parametrize(
    ("way", "reason"),
    [
        ("late", "error: printed more than its answer"),
        ("later", "error: expected the answer to {}, found type None"),
    ],
)
def test_a_late_line_costs_one_frame_and_not_those_after_it(frames, tmp_path, way, reason):
    """It arrives between two frames, or in place of the next answer."""
    pool = pool_of(folder_of(tmp_path, way))
    try:
        with pool.idle_session() as running:
            responses = []
            for frame in frames:
                responses.append(running.answer(frame, None))
                time.sleep(0.4)
    finally:
        pool.close()
    assert responses[1].answer.reason == reason.format(frames[1].frame_id)
    assert [one.status for one in responses] == ["fix", "error", "fix"]


@pytest.mark.parametrize(("way", "message"), [("no hello", "no answer within 1 s"), ("wrong hello", "does not speak")])
def test_a_program_that_does_not_greet_is_an_error_of_the_user(way, message):
    with session(way, Limits(start_s=1.0)) as running, pytest.raises(SolverError, match=message):
        running.start()


def test_a_program_that_is_not_there_is_an_error_of_the_user(tmp_path):
    with (
        ProgramSession(["/no/such/program"], tmp_path, LIMITS) as running,
        pytest.raises(SolverError, match="No such file"),
    ):
        running.start()


def folder_of(tmp_path, way):
    (tmp_path / "program.py").write_bytes(PROGRAM.read_bytes())
    spec = SolverSpec(
        name="mine", title="A program", licence="MIT", version="1", command=("python", "program.py", way),
        time_limit_s=1.0, memory_limit_mib=600,
    )  # fmt: skip
    return SolverFolder(tmp_path, spec)


def pool_of(solver, jobs=1):
    contestant = contestant_of(solver)
    return SessionPool(lambda: contestant.make_session(jobs), jobs)


def judged(tmp_path, way, frames):
    pool = pool_of(folder_of(tmp_path, way))
    try:
        return [outcome.score for outcome in outcomes(frames, pool, "own", {})]
    finally:
        pool.close()


def test_a_program_finds_no_truth_beside_the_image(frames, tmp_path):
    scores = judged(tmp_path, "spy", frames)
    assert [score.reason for score in scores] == ["saw 1.png", "saw 2.png", "saw 3.png"]


@pytest.mark.parametrize("way", ["crash", "hang", "other frame", "well"])
def test_given_detections_count_however_a_program_fails(frames, tmp_path, way):
    given = Points(np.array([[10.0, 20.0], [30.0, 40.0]]), None)
    pool = pool_of(folder_of(tmp_path, way))
    try:
        with pool.idle_session() as running:
            response = running.answer(frames[0], given)
    finally:
        pool.close()
    assert response.status == ("fix" if way == "well" else "error")
    assert response.uv.tolist() == given.uv.tolist()


def test_a_crash_costs_one_frame_and_the_program_goes_on(frames, tmp_path):
    # It crashes at the first request after each start: at the warm-up, and again after every restart.
    scores = judged(tmp_path, "crash", frames)
    assert [score.status for score in scores] == ["error"] * 3
    assert all("exit status 7" in score.reason for score in scores)
    assert all(score.error_km == float("inf") for score in scores)


def test_a_well_behaved_program_is_judged_by_its_answers(frames, tmp_path):
    scores = judged(tmp_path, "well", frames)
    assert [score.status for score in scores] == ["fix"] * 3
    assert scores[0].error_km == 0.0  # the first of the fake night's sites is where it says it always is
    assert scores[1].error_km > 1000.0


def test_a_pool_keeps_as_many_processes_as_jobs(frames, tmp_path):
    # This program counts its requests in the latitude: the first is the warm-up, which is not judged.
    pool = pool_of(folder_of(tmp_path, "count"), 2)

    def answered(frame):
        with pool.idle_session() as session:
            return session.answer(frame, None).answer

    try:
        with ThreadPoolExecutor(5) as threads:
            answers = list(threads.map(answered, frames * 5))
        children = [child for child in psutil.Process().children() if "program.py" in " ".join(child.cmdline())]
        assert len(children) <= 2
    finally:
        pool.close()
    counts = sorted(answer.lat_deg for answer in answers)
    assert counts[0] == 2.0
    assert sum(count == 2.0 for count in counts) == len(children)
    assert len(counts) == 15


def test_an_answer_to_another_frame_is_an_error(frames, tmp_path):
    assert {score.reason for score in judged(tmp_path, "other frame", frames)} == {
        f"error: expected the answer to {frame.frame_id}, found type 'fix'" for frame in frames
    }


def test_a_program_of_another_version_is_refused(tmp_path):
    other = folder_of(tmp_path, "well")
    spec = other.spec.model_copy(update={"version": "2"})
    with pytest.raises(SolverError, match=r"says version '1', its solver\.yaml '2'"):
        pool_of(SolverFolder(tmp_path, spec))


GOOD = {"type": "fix", "frame_id": "frame-00000", "status": "fix", "lat_deg": 1.0, "lon_deg": 2.0}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame_id": "frame-00001"}, "expected the answer to frame-00000"),
        ({"status": "maybe"}, "status is 'maybe'"),
        ({"lat_deg": "1.0"}, "lat_deg must be a finite number"),
        ({"lat_deg": float("nan")}, "lat_deg must be a finite number"),
        ({"lon_deg": True}, "lon_deg must be a finite number"),
        ({"status": "attitude"}, "R_icrs_to_camera"),
        ({"status": "attitude", "R_icrs_to_camera": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "not a rotation"),
        ({"status": "attitude", "R_icrs_to_camera": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "reflection"),
        ({"detections": {"uv": [[1, 2], [3]]}}, "detections.uv"),
        ({"detections": {"uv": [[1, 2]], "flux": [1, 2]}}, "detections.flux"),
        ({"detections": {"uv": [[0, 0]] * 100_001}}, "more than 100000"),
        ({"matches": [[0, 1.5]]}, "pairs of integers"),
        ({"matches": [[0, 2**40]]}, "32 bits"),
        ({"matches": "all"}, "list of"),
        ({"cov_ee_km2": 1.0}, "cov_en_km2 must be"),
        ({"confidence": "high"}, "confidence must be"),
        ({"time_ms": {str(n): 1.0 for n in range(51)}}, "at most 50"),
        ({"status": "error", "reason": "ValueError:\n x"}, "ValueError: x"),
    ],
)
def test_an_answer_that_is_not_of_the_protocol_is_refused(frames, change, message):
    with pytest.raises(ValueError, match=message):
        reply_of(GOOD | change, "frame-00000", frames[0].observation, None)


def test_a_good_answer_is_read_whole(frames):
    more = {
        "cov_ee_km2": 1.0, "cov_en_km2": 0.1, "cov_nn_km2": 2.0, "confidence": 0.5, "matches": [[0, -7]],
        "detections": {"uv": [[3.0, 4.0]], "flux": [5.0]}, "time_ms": {"detect": 2.5},
    }  # fmt: skip
    reply = reply_of(json.loads(json.dumps(GOOD | more)), "frame-00000", frames[0].observation, None)
    assert (reply.answer.lat_deg, reply.answer.lon_deg, reply.answer.confidence) == (1.0, 2.0, 0.5)
    assert reply.answer.cov_km2.tolist() == [[1.0, 0.1], [0.1, 2.0]]
    assert (reply.uv.tolist(), reply.flux.tolist(), reply.answer.matches.tolist()) == ([[3.0, 4.0]], [5.0], [[0, -7]])
    assert reply.detect_ms == 2.5


def test_a_brightness_that_is_not_known_stays_unknown(frames):
    found = {"uv": [[1.0, 2.0], [3.0, 4.0]], "flux": [None, 5]}
    reply = reply_of(GOOD | {"detections": found}, "frame-00000", frames[0].observation, None)
    np.testing.assert_array_equal(reply.flux, [np.nan, 5.0])
    again = request_of(frames[0], Points(reply.uv, reply.flux), frames[0].image_path)
    assert again["detections"] == found


def test_shared_detections_of_many_frames_take_bounded_memory():
    """Of 100 images of 100 points each, at most as many are kept as fit; the others are made again."""
    kept, made = KeptDetections(most_points=1200), []

    def points(name):
        made.append(name)
        return Points(np.zeros((100, 2)), None)

    for name in range(100):
        kept.of(Path(str(name)), lambda name=name: points(name))
    for name in (99, 90, 0):
        assert len(kept.of(Path(str(name)), lambda name=name: points(name)).uv) == 100
    assert made == [*range(100), 0]


def test_a_request_holds_the_observation_and_no_truth(frames):
    request = request_of(frames[0], None, frames[0].image_path)
    assert set(request) == {
        "type", "frame_id", "image", "camera", "utc_mid", "R_cam", "tilt_sigma_deg", "heading_sigma_deg",
        "pressure_hpa", "temperature_c", "detections", "time_limit_s", *SIGMAS,
    }  # fmt: skip
    assert request["detections"] is None
    json.dumps(request, allow_nan=False)


def test_shared_detections_are_what_matches_point_to(frames):
    class Given:
        uv = np.array([[1.0, 2.0], [3.0, 4.0]])
        flux = None

    request = request_of(frames[0], Given, frames[0].image_path)
    assert request["detections"] == {"uv": [[1.0, 2.0], [3.0, 4.0]], "flux": [None, None]}
    reply = reply_of(GOOD | {"detections": {"uv": [[9.0, 9.0]]}}, "frame-00000", frames[0].observation, Given)
    assert reply.uv.tolist() == [[1.0, 2.0], [3.0, 4.0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\n", "title"),
        ("name: mine\ntitle: A solver\nlicence: MIT\n", "either adapter or command"),
        ("name: mine\ntitle: A solver\nlicence: MIT\ncommand: [a]\n", "command needs version"),
        ("name: ../mine\ntitle: A solver\nlicence: MIT\nadapter: celnav\n", "name"),
        ("name: mine\ntitle: A solver\nlicence: MIT\nadapter: os.system\n", "adapter"),
        ("name: mine\ntitle: A solver\nlicence: MIT\nadapter: celnav\nshell: yes\n", "shell"),
        ("{", "cannot be read"),
    ],
)
def test_a_wrong_solver_file_is_refused_by_key(tmp_path, text, message):
    (tmp_path / "solver.yaml").write_text(text)
    with pytest.raises(SolverError, match=message):
        read_solver_folder(tmp_path)


def test_a_missing_environment_says_how_to_make_it(monkeypatch, tmp_path):
    monkeypatch.setenv("SKYBENCH_ENVIRONMENTS", str(tmp_path))
    with pytest.raises(SolverError, match=r"python3 -m venv .*cedar-solve && .*pip install -r .*requirements\.txt"):
        solver_folder("cedar-solve").command_line()
    with pytest.raises(SolverError, match="program of its own"):
        make_solver("cedar-solve")


def test_a_missing_package_says_what_to_install(monkeypatch):
    monkeypatch.setattr("benchmark.solvers.registry._installed_version", {"tetra3rs": "0.1.0"}.get)
    with pytest.raises(SolverError, match=r"needs tetra3rs==0\.14\.0; install with: pip install 'skybench\[peers\]'"):
        make_solver("tetra3rs")


def test_all_of_celnavs_solvers_and_the_peers_are_there():
    import celnav

    assert set(celnav.solvers()) <= set(known_solvers())
    assert {"tetra3rs", "ruststartracker", "zenith-fixer", "cedar-solve"} <= set(known_solvers())


def test_every_contestants_folder_says_what_it_is():
    for name in known_solvers():
        assert (solver_folder(name).folder / "README.md").read_text(encoding="utf-8").startswith(f"# {name}\n"), name


def test_a_changed_file_changes_the_revision(tmp_path):
    before = folder_of(tmp_path, "well").revision
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__" / "x.pyc").write_bytes(os.urandom(8))
    assert folder_of(tmp_path, "well").revision == before
    (tmp_path / "weights.csv").write_text("1")
    assert folder_of(tmp_path, "well").revision != before
