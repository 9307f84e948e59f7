"""Ctrl-C: one line and exit status 130, whatever it interrupts.

Some libraries turn the KeyboardInterrupt that strikes while they are imported into an error of their own; the handler here
remembers that there was one.
"""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType
from typing import NoReturn

EXIT_INTERRUPTED = 130
_struck = threading.Event()


def listen() -> None:
    """Handle SIGINT from now on; for the main thread."""
    signal.signal(signal.SIGINT, _strike)


def _strike(number: int, frame: FrameType | None) -> NoReturn:
    _struck.set()
    raise KeyboardInterrupt


def interrupted(error: BaseException) -> bool:
    """Whether an error is what Ctrl-C made of the work."""
    return _struck.is_set() or isinstance(error, KeyboardInterrupt)


def say_so() -> None:
    """Print the line."""
    print("skybench: interrupted; the same command continues", file=sys.stderr, flush=True)
