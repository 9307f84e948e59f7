"""Connected components of a list of pixels, without a pass over the image, of which they are a small part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.intp]


def connected(at: Rows, width: int) -> tuple[NDArray[np.int32], int]:
    """Label the connected components of pixels that touch at their sides or corners.

    Parameters
    ----------
    at : ndarray of int, shape (n,)
        Pixels as indices of the flattened image, in order.
    width : int
        Width of the image.

    Returns
    -------
    label : ndarray of int32, shape (n,)
        Component of each pixel, numbered from 1 in the order of their first pixels.
    number : int
        Number of components.
    """
    if not len(at):
        return np.zeros(0, dtype=np.int32), 0
    row = at // width
    begins = np.empty(len(at), dtype=bool)
    begins[0] = True
    np.not_equal(at[1:] - at[:-1], 1, out=begins[1:])
    begins |= at == row * width
    start = begins.nonzero()[0]
    first, last = at.take(start), at.take(np.append(start[1:], len(at)) - 1)
    # Find the runs of the next row that touch each run.
    next_row = (row.take(start) + 1) * width
    low = _number_below(np.maximum(first + (width - 1), next_row), last)
    high = _number_below(np.minimum(last + (width + 2), next_row + width), first)
    count = np.maximum(high - low, 0)
    end = count.cumsum()
    above = np.arange(len(first)).repeat(count)
    below = np.arange(end[-1]) + (low - end + count).repeat(count)
    root = _earliest(len(first), above, below)
    is_root = root == np.arange(len(root))
    number = is_root.cumsum(dtype=np.int32)
    return number.take(root).take(begins.cumsum() - 1), int(number[-1])


def _number_below(limits: Rows, values: Rows) -> Rows:
    """Return how many of some ascending values are less than each of some ascending limits, shape (limits,).

    A stable sort merges the two lists, in half of the time of a binary search for each.
    """
    order = np.concatenate((limits, values)).argsort(kind="stable")
    return (order < len(limits)).nonzero()[0] - np.arange(len(limits))


def _earliest(n: int, above: Rows, below: Rows) -> Rows:
    """Return the first run that each of `n` runs is connected with, shape (n,), if runs in `above` touch those in `below`."""
    root = np.arange(n)
    while len(above):
        # Every root is joined to an earlier one; if it touches several, the others wait for the next round.
        root[below] = above
        further = root.take(root)
        while not np.array_equal(further, root):
            root, further = further, further.take(further)
        above, below = root.take(above), root.take(below)
        apart = (above != below).nonzero()[0]
        above, below = above.take(apart), below.take(apart)
        above, below = np.minimum(above, below), np.maximum(above, below)
    return root
