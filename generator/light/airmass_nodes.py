"""Airmasses at which starlight is tabulated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEVEL_NODES, LARGEST_AIRMASS = 224, 40.0
"""The largest airmass exceeds the 37.92 of the horizontal."""
DIPPING_NODES, LARGEST_DIPPING_AIRMASS = 387, 1000.0
"""Number of nodes and largest airmass for rays from below the horizontal; at larger airmass no light is left."""
AIRMASS_SCALE = 0.5
"""Nodes are evenly spaced in log(airmass + this)."""


def largest_airmass(count: int) -> float:
    """Airmass of the last of `count` nodes."""
    return LARGEST_DIPPING_AIRMASS if count == DIPPING_NODES else LARGEST_AIRMASS


def airmass_nodes(count: int = LEVEL_NODES) -> Floats:
    """Return the nodes of a table, from 0; `count` is LEVEL_NODES or DIPPING_NODES."""
    return AIRMASS_SCALE * np.expm1(np.linspace(0, np.log1p(largest_airmass(count) / AIRMASS_SCALE), count))


def node_place(airmass: Floats, count: int) -> Floats:
    """Return the fractional index of the node at given airmasses."""
    return np.log1p(airmass / AIRMASS_SCALE) * ((count - 1) / np.log1p(largest_airmass(count) / AIRMASS_SCALE))
