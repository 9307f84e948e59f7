"""Ctrl-C and SIGTERM: one line and exit status 130 or 143, whatever they interrupt.

Some libraries turn the KeyboardInterrupt that strikes while they are imported into an error of their own; the handler here
remembers that there was one.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import NoReturn

_struck: list[int] = []
"""Signals that have come."""


def listen() -> None:
    """Handle both signals from now on; for the main thread."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _strike)


def _strike(number: int, frame: FrameType | None) -> NoReturn:
    _struck.append(number)
    raise KeyboardInterrupt


def interrupted(error: BaseException) -> bool:
    """Whether an error is what a signal made of the work."""
    return bool(_struck) or isinstance(error, KeyboardInterrupt)


def exit_status() -> int:
    """128 and the number of the signal, as shells have it."""
    return 128 + (_struck[0] if _struck else signal.SIGINT)


def say_so() -> None:
    """Print the line."""
    print("skybench: interrupted; the same command continues", file=sys.stderr, flush=True)
