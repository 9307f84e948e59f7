"""Ctrl-C at moments at which Python drops the exception of a signal's handler."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = """
import os, signal, time, weakref
from benchmark.cli import interrupt

interrupt.AGAIN_S = 0.05
interrupt.listen()

class Thing:
    pass

thing = Thing()
kept = weakref.ref(thing, lambda gone: os.kill(os.getpid(), signal.SIGINT))
try:
    del thing
    for _ in range(400):
        time.sleep(0.05)
    print("never struck")
except KeyboardInterrupt as error:
    print(interrupt.interrupted(error), interrupt.exit_status())
    time.sleep(0.2)
    print("left in peace")
"""


def test_a_signal_that_strikes_in_a_callback_strikes_again() -> None:
    """The exception of the first strike is dropped by the weak reference; after notice is taken there is no third one."""
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, text=True, timeout=120, check=True
    )
    assert run.stdout == "True 130\nleft in peace\n"
    assert "Exception ignored" in run.stderr
