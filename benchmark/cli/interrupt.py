"""Ctrl-C and SIGTERM: one line and exit status 130 or 143, whatever they interrupt.

Some libraries turn a KeyboardInterrupt during their import into an error of their own, so the handler here remembers that
there was one. Python drops an exception that is raised in a finalizer or in the callback of a weak reference, including the
import system's locks; a signal that has gone unnoticed is therefore raised again.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import NoReturn

_struck: list[int] = []
"""Signals that have been received."""


AGAIN_S = 5.0
"""Longer than a command takes to clean up."""


def listen() -> None:
    """Handle both signals from now on; to be called in the main thread."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _strike)
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _strike_again)


def _strike(number: int, frame: FrameType | None) -> NoReturn:
    _struck.append(number)
    _strike_again(number, frame)


def _strike_again(number: int, frame: FrameType | None) -> NoReturn:
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    raise KeyboardInterrupt


def interrupted(error: BaseException) -> bool:
    """Whether an error was caused by a signal; if so, the signal is not raised again."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)
    return bool(_struck) or isinstance(error, KeyboardInterrupt)


def exit_status() -> int:
    """128 plus the number of the signal, as in shells."""
    return 128 + (_struck[0] if _struck else signal.SIGINT)


def say_so() -> None:
    """Print the line about the interruption."""
    print("skybench: interrupted; the same command continues", file=sys.stderr, flush=True)
