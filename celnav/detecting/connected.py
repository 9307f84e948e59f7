"""Connected pixels of a list of pixels: the image itself, of which they are a small part, is not gone through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def connected(at: NDArray[np.intp], width: int) -> tuple[NDArray[np.int32], int]:
    """Number the components of pixels that touch at their sides or corners.

    Parameters
    ----------
    at : ndarray of int, shape (n,)
        Pixels as indices of the flattened image, in order.
    width : int
        Of the image.

    Returns
    -------
    label : ndarray of int32, shape (n,)
        Component of each pixel, from 1 on, in the order of their first pixels.
    number : int
        Components.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    if not len(at):
        return np.zeros(0, dtype=np.int32), 0
    begins = np.diff(at, prepend=at[0] - 2) != 1
    begins |= at % width == 0
    start = np.flatnonzero(begins)
    first, last = at[start], at[np.append(start[1:], len(at)) - 1]
    # Runs of the next row that touch each run.
    next_row = (first // width + 1) * width
    low = np.searchsorted(last, np.maximum(first + width - 1, next_row))
    high = np.searchsorted(first, np.minimum(last + width + 1, next_row + width - 1), side="right")
    count = np.maximum(high - low, 0)
    bounds = np.concatenate(([0], np.cumsum(count)))
    touching = np.repeat(low - bounds[:-1], count) + np.arange(bounds[-1])
    graph = csr_array((np.ones(len(touching), dtype=np.int8), touching, bounds), shape=(len(first), len(first)))
    number, of_run = connected_components(graph, directed=False)
    return np.asarray(of_run[np.cumsum(begins) - 1] + 1, dtype=np.int32), int(number)
