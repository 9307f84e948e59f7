"""Processes that end with the one that started them, however that ends."""

from __future__ import annotations

import multiprocessing
import os
import threading

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
