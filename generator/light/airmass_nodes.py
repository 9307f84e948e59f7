"""Airmasses at which tables of starlight are made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEVEL_NODES, LARGEST_AIRMASS = 224, 40.0
"""Above the 37.92 of the horizontal."""
DIPPING_NODES, LARGEST_DIPPING_AIRMASS = 387, 1000.0
"""The same for rays from below the horizontal; with more, no light is left."""
AIRMASS_SCALE = 0.5
"""Nodes are evenly spaced in log(airmass + this)."""


def largest_airmass(count: int) -> float:
    """Airmass of the last of `count` nodes."""
    return LARGEST_DIPPING_AIRMASS if count == DIPPING_NODES else LARGEST_AIRMASS


def airmass_nodes(count: int = LEVEL_NODES) -> Floats:
    """The nodes of a table, from 0: LEVEL_NODES or DIPPING_NODES of them."""
    return AIRMASS_SCALE * np.expm1(np.linspace(0, np.log1p(largest_airmass(count) / AIRMASS_SCALE), count))


def node_place(airmass: Floats, count: int) -> Floats:
    """Fractional number of the node at airmasses."""
    return np.log1p(airmass / AIRMASS_SCALE) * ((count - 1) / np.log1p(largest_airmass(count) / AIRMASS_SCALE))
