"""Ctrl-C and SIGTERM: one line and exit status 130 or 143, whatever they interrupt.

Some libraries turn the KeyboardInterrupt that strikes while they are imported into an error of their own; the handler here
remembers that there was one. Python drops an exception that is raised in a finalizer or in the callback of a weak reference,
the import system's locks among them; a signal of which nobody has taken notice strikes again.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import NoReturn

_struck: list[int] = []
"""Signals that have come."""


AGAIN_S = 5.0
"""Longer than a command takes to clear up."""


def listen() -> None:
    """Handle both signals from now on; for the main thread."""
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
    """Whether an error is what a signal made of the work; from now on it does not strike again."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)
    return bool(_struck) or isinstance(error, KeyboardInterrupt)


def exit_status() -> int:
    """128 and the number of the signal, as shells have it."""
    return 128 + (_struck[0] if _struck else signal.SIGINT)


def say_so() -> None:
    """Print the line."""
    print("skybench: interrupted; the same command continues", file=sys.stderr, flush=True)
