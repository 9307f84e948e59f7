"""Start worker processes, and end them with the process that started them, however that one ends.

This module imports only the standard library, so a process that starts here decides how the rest is loaded.
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
"""Exit status of a process whose parent has ended."""


def follow_parent() -> None:
    """End this process as soon as its parent has ended; has no effect outside processes of `multiprocessing`.

    A thread waits for a pipe that closes when the parent ends. This works even if the parent is killed and cannot clean
    up.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(ORPHANED)

    threading.Thread(target=wait, name="follow-parent", daemon=True).start()


def packed(function: Callable[..., None], *arguments: Any) -> bytes:
    """Pickle a call for :func:`begin`, which imports the necessary modules only in the worker."""
    return pickle.dumps((function, arguments))


def begin(call: bytes) -> None:
    """Start a single-threaded worker process: load what a call of :func:`packed` needs, and execute the call.

    Garbage collection is off meanwhile, since modules are not garbage and scanning them repeatedly takes a tenth of the
    start. Linear algebra gets no threads of its own, because these wait in busy loops for work that never comes. It
    uses the same instructions as in the calling process (`generator.instruction_set`), so frames of both are identical
    to the byte.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()
    try:
        # The data come from this program itself, over the pipe through which `multiprocessing` starts the process.
        function, arguments = pickle.loads(call)
        function(*arguments)
    finally:
        gc.freeze()
        gc.enable()
