"""Whatever a program answers costs its own frame at most: any JSON is judged, or refused with a reason that can be stored."""

import json
import signal
import sys

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from unit.benchmark.fake_night import write_dataset

from benchmark.frames.dataset import open_dataset
from benchmark.judge.answers import Response, check_answer, check_points, failure, judge_answer
from benchmark.run.result_tables import frame_table, match_table
from benchmark.solvers.messages import reply_of, request_of
from benchmark.solvers.program import Limits, ProgramFailedError, ProgramSession
from benchmark.stats.metrics import FIX, REFUSED, summarise

HUGE = 10**400 + 1
TEXTS = st.text(max_size=30) | st.sampled_from(["\ud800", "\x00", "a\u2028b", "<script>", "x" * 500, "nan"])
NUMBERS = (
    st.floats()
    | st.integers()
    | st.sampled_from([HUGE, -HUGE, 2**31, 2**63, 1e308, -1e308, 5e-324, 90.0, -180.0, 360.0, True, None, 1e12, 0.0])
)
ODD = st.recursive(
    NUMBERS | TEXTS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=6,
)
POINTS = st.lists(st.tuples(NUMBERS, NUMBERS), max_size=5)
ANSWERS = st.fixed_dictionaries(
    {"status": st.sampled_from(["fix", "attitude", "refused", "error"]) | ODD},
    optional={
        "lat_deg": st.floats(-90, 90) | NUMBERS | ODD,
        "lon_deg": st.floats(-180, 180) | NUMBERS | ODD,
        "R_icrs_to_camera": st.lists(st.lists(NUMBERS, min_size=3, max_size=3), min_size=3, max_size=3) | ODD,
        "reason": TEXTS | ODD,
        "cov_ee_km2": NUMBERS,
        "cov_en_km2": NUMBERS,
        "cov_nn_km2": NUMBERS,
        "confidence": st.floats(0, 1) | NUMBERS | ODD,
        "detections": st.fixed_dictionaries({"uv": POINTS}, optional={"flux": st.lists(NUMBERS, max_size=5)}) | ODD,
        "matches": st.lists(st.lists(st.integers(-2, 5) | NUMBERS, min_size=2, max_size=2), max_size=4) | ODD,
        "time_ms": st.dictionaries(TEXTS, NUMBERS, max_size=3) | ODD,
    },
)
WHOLE = {"status": "fix", "lat_deg": 48.0, "lon_deg": 11.0}


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    return open_dataset(write_dataset(tmp_path_factory.mktemp("data") / "night", (1,))).frames[0]


@settings(max_examples=300, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(answer=ANSWERS)
@example(answer=WHOLE | {"lat_deg": HUGE})
@example(answer=WHOLE | {"lon_deg": 1e308})
@example(answer=WHOLE | {"detections": {"uv": [[HUGE, 1.0]]}})
@example(answer=WHOLE | {"detections": {"uv": [[1e308, -1e308]], "flux": [HUGE]}})
@example(answer=WHOLE | {"cov_ee_km2": 1e308, "cov_en_km2": 1e308, "cov_nn_km2": 1e308})
@example(answer={"status": "attitude", "R_icrs_to_camera": [[HUGE, 0, 0], [0, 1, 0], [0, 0, 1]]})
@example(answer={"status": "attitude", "R_icrs_to_camera": [[0, 0, 0], [0, 0, 0], [0, 0, 1.4e154]]})
@example(answer={"status": "refused", "reason": "\ud800"})
@example(answer={"status": "error", "reason": "\ud800"})
@example(answer=WHOLE | {"time_ms": {"\ud800": HUGE}})
@example(answer=WHOLE | {"time_ms": {"\ud800": 1.0}})
def test_any_answer_is_judged_or_refused_and_stored(frame, answer) -> None:
    """As `PipeSession.answer` and the engine treat it, up to the tables of the result."""
    message = json.loads(json.dumps({"type": "fix", "frame_id": frame.frame_id, **answer}))
    try:
        reply = reply_of(message, frame.frame_id, frame.observation, None)
        check_points(reply.uv, reply.flux)
        check_answer(reply.answer, len(reply.uv))
        status = FIX if reply.answer.ok else REFUSED
        response = Response(reply.answer, status, reply.uv, reply.flux, reply.detect_ms, 1.0, None)
    except ValueError as error:
        response = failure(f"error: {error}", 1.0)
        assert response.answer.reason
    outcome = judge_answer(frame, response, 0.3)
    rows = frame_table([outcome])
    rows.validate(full=True)
    match_table([outcome]).validate(full=True)
    assert summarise([outcome.score]).n_frames == 1


@pytest.mark.parametrize(
    ("number", "name"),
    [(signal.SIGKILL, "SIGKILL"), (signal.SIGRTMIN + 3, str(signal.SIGRTMIN + 3))],
)
def test_a_death_by_any_signal_is_named(frame, tmp_path, number, name) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "import json, os, sys\n"
        "sys.stdin.readline()\n"
        "print(json.dumps({'type': 'hello', 'protocol': 'skybench-solver/1'}), flush=True)\n"
        "sys.stdin.readline()\n"
        f"os.kill(os.getpid(), {int(number)})\n"
    )
    with ProgramSession([sys.executable, str(program)], tmp_path, Limits(time_s=20.0)) as running:
        running.start()
        with pytest.raises(ProgramFailedError, match=f"ended by signal {name}"):
            running.ask(request_of(frame, None, frame.image_path))
