"""The kinds of faults: names, units and sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass

NARROW_DEG = 60.0
"""Field of the pinhole for refraction where the scenario's camera is wider, so that it sees no horizon when tilted."""


@dataclass(frozen=True)
class Kind:
    """A kind of fault in several sizes.

    Attributes
    ----------
    key, title, unit : str
    sizes : tuple of float
    typical : float
        The size shown in the summary.
    least, most : float
        Range of sizes that can be requested.
    logarithmic : bool
        Whether sizes are spaced by factors.
    """

    key: str
    title: str
    unit: str
    sizes: tuple[float, ...]
    typical: float
    least: float = 0.0
    most: float = math.inf
    logarithmic: bool = True


KINDS = {
    kind.key: kind
    for kind in (
        Kind("focal", "Focal length too long", "%", (0.1, 0.3, 1.0, 3.0), 0.3, most=30.0),
        Kind("centre", "Principal point off", "px", (0.3, 1.0, 3.0, 10.0), 1.0, most=1000.0),
        Kind("k1", "Radial distortion k1 too large", "", (1e-4, 3e-4, 1e-3, 3e-3, 1e-2), 3e-4, most=100.0),
        Kind(
            "projection",
            "Stereographic lens declared as pinhole, by horizontal field",
            "deg",
            (20.0, 40.0, 60.0, 80.0, 100.0, 120.0),
            40.0,
            least=1.0,
            most=150.0,
            logarithmic=False,
        ),
        Kind("tilt", "Vertical off", "deg", (0.01, 0.03, 0.1, 0.3, 1.0), 0.1, most=30.0),
        Kind("heading", "Heading off", "deg", (0.01, 0.03, 0.1, 0.3, 0.9), 0.1, most=30.0),
        Kind("clock", "Clock fast", "s", (0.1, 1.0, 10.0, 100.0), 10.0, most=3600.0),
        Kind(
            "refraction",
            f"Refraction neglected, by tilt of a {NARROW_DEG:g} deg camera",
            "deg",
            (0.0, 10.0, 20.0, 30.0, 40.0),
            30.0,
            most=60.0,
            logarithmic=False,
        ),
        Kind("epoch", "Epoch of the sky too early", "yr", (1.0, 3.0, 10.0, 25.0), 10.0, most=50.0),
    )
}
"""Kinds by key, in the order of the page."""
