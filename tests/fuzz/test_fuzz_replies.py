"""The pipe protocol: any line that a program prints is a reply, or a reason for which its frame is lost.

What JSON objects come to, up to the tables of the results, is in tests/unit/benchmark/test_hostile_answers.py.
"""

import sys
from contextlib import suppress

import pytest
from fuzz.fuzzing import corpus, damaged, fuzzed
from hypothesis import given
from unit.benchmark.fake_night import write_dataset

from benchmark.frames.dataset import open_dataset
from benchmark.solvers.messages import reply_of, request_of
from benchmark.solvers.program import Limits, ProgramFailedError, ProgramSession

FILES = corpus("replies")
PROGRAM = """
import sys
for line in sys.stdin:
    if '"hello"' in line:
        print('{"type": "hello", "protocol": "skybench-solver/1"}', flush=True)
    else:
        with open("answer", "rb") as answer:
            sys.stdout.buffer.write(answer.read())
        sys.stdout.flush()
"""


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    return open_dataset(write_dataset(tmp_path_factory.mktemp("fuzz") / "night", (1,))).frames[0]


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A program that prints the contents of a file for every frame."""
    folder = tmp_path_factory.mktemp("program")
    (folder / "program.py").write_text(PROGRAM)
    with ProgramSession([sys.executable, "-S", "program.py"], folder, Limits(time_s=20.0)) as running:
        yield running, folder


def put(session, frame, content: bytes) -> None:
    """Put the frame to the program and read its reply as the engine does."""
    running, folder = session
    (folder / "answer").write_bytes(content + b"\n")
    if not running.running:
        running.start()
    with suppress(ProgramFailedError, ValueError):
        message = running.ask(request_of(frame, None, frame.image_path)).message
        reply_of(message, frame.frame_id, frame.observation, None)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_corpus(session, frame, path) -> None:
    put(session, frame, path.read_bytes())


@fuzzed(10)
@given(content=damaged([path.read_bytes() for path in FILES]))
def test_any_bytes(session, frame, content) -> None:
    put(session, frame, content)
