"""Worker processes: their start, and their end with the one that started them, however that ends.

This module imports nothing but Python's own, so that a process that starts here decides how it loads the rest.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable
from typing import Any

ORPHANED = 70
"""Exit status of a process whose parent is gone."""


def follow_parent() -> None:
    """End this process as soon as the one that started it has ended; for processes of `multiprocessing`, elsewhere nothing.

    The parent's end closes a pipe that a thread here waits for, also when the parent is killed and can ask for nothing.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(ORPHANED)

    threading.Thread(target=wait, name="follow-parent", daemon=True).start()


def packed(function: Callable[..., None], *arguments: Any) -> bytes:
    """A call for :func:`begin`, which imports what it needs only there."""
    return pickle.dumps((function, arguments))


def begin(call: bytes) -> None:
    """Start a worker process of one thread: load what a call of :func:`packed` needs, and make it.

    The process does not look for garbage meanwhile: modules are none, and looking through them again and again takes a tenth
    of the start. Linear algebra has no threads of its own, which wait in busy loops for work that never comes. Its
    instructions are those of the calling process (`generator.instruction_set`): frames of both are alike to the byte.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()
    try:
        # Of this program itself, by the pipe through which `multiprocessing` starts the process.
        function, arguments = pickle.loads(call)
        function(*arguments)
    finally:
        gc.freeze()
        gc.enable()
