"""Points of light with colours, as the renderer draws them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PointLights:
    """Points of light.

    Attributes
    ----------
    directions : (n, k, 3) array
        Apparent unit vectors, evenly spaced over the shutter's time.
    v_mag, bv_mag, vi_mag, airmass : (n,) arrays
    hidden : (n, 2) array
        Fractions of the shutter's time between which the Moon is in front; inf if it never is.
    """

    directions: Floats
    v_mag: Floats
    bv_mag: Floats
    vi_mag: Floats
    airmass: Floats
    hidden: Floats

    @classmethod
    def in_the_open(
        cls, directions: Floats, v_mag: Floats, bv_mag: Floats, vi_mag: Floats, airmass: Floats
    ) -> PointLights:
        """Return points of light that nothing hides."""
        return cls(directions, v_mag, bv_mag, vi_mag, airmass, np.full((len(v_mag), 2), np.inf))

    def __len__(self) -> int:
        return len(self.v_mag)

    def __getitem__(self, rows: NDArray[np.intp]) -> PointLights:
        """Return the points of the given rows, in their order."""
        return PointLights(*(column[rows] for column in self._columns))

    def joined(self, other: PointLights) -> PointLights:
        """Return these points followed by others."""
        pairs = zip(self._columns, other._columns, strict=True)
        return PointLights(*(np.concatenate(pair) for pair in pairs))

    @property
    def _columns(self) -> tuple[Floats, ...]:
        return self.directions, self.v_mag, self.bv_mag, self.vi_mag, self.airmass, self.hidden
