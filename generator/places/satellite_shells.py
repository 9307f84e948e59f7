"""Shells of satellites: Walker constellations of circular orbits, propagated with the Earth's oblateness.

Mean motion, and the secular rates of the node and of the argument of latitude by J2, for circular orbits: Vallado 2013,
"Fundamentals of astrodynamics and applications", section 9.6. The shadow is a cylinder of the Earth's radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GM_KM3_S2 = 398600.4418
EQUATORIAL_KM = 6378.137
J2 = 1.08262668e-3


@dataclass(frozen=True)
class Shell:
    """A Walker delta constellation: planes at equal steps of the node, satellites at equal steps within each.

    Attributes
    ----------
    altitude_km, inclination_deg : float
    planes, per_plane : int
    node_deg, argument_deg : float
        Node and argument of latitude of the first satellite at J2000.
    phasing : int
        Satellites of the next plane are ahead by this many 1 / (planes x per_plane) of a turn.
    """

    altitude_km: float
    inclination_deg: float
    planes: int
    per_plane: int
    node_deg: float = 0.0
    argument_deg: float = 0.0
    phasing: int = 0

    def positions_km(self, seconds: Floats, rows: NDArray[np.intp] | None = None) -> Floats:
        """Places of satellites in the true-equator frame, (n, k, 3) array.

        Parameters
        ----------
        seconds : (k,) or (n, k) array
            Time from J2000, either common to all or individual for each satellite.
        rows : (n,) int array or None
            Indices of the planes x per_plane satellites; None for all.
        """
        radius = EQUATORIAL_KM + self.altitude_km
        inclination = np.radians(self.inclination_deg)
        motion = np.sqrt(GM_KM3_S2 / radius**3)
        flattening = 1.5 * J2 * (EQUATORIAL_KM / radius) ** 2
        node_rate = -flattening * motion * np.cos(inclination)
        argument_rate = motion * (1 + flattening * (4 * np.cos(inclination) ** 2 - 1))
        everyone = np.arange(self.planes * self.per_plane) if rows is None else rows
        plane, place = (part[:, None] for part in np.divmod(everyone, self.per_plane))
        node = np.radians(self.node_deg) + 2 * np.pi * plane / self.planes + node_rate * seconds
        turn = place / self.per_plane + self.phasing * plane / (self.planes * self.per_plane)
        argument = np.radians(self.argument_deg) + 2 * np.pi * turn + argument_rate * seconds
        along, across = np.cos(argument), np.sin(argument) * np.cos(inclination)
        x = along * np.cos(node) - across * np.sin(node)
        y = along * np.sin(node) + across * np.cos(node)
        return radius * np.stack([x, y, np.sin(argument) * np.sin(inclination)], axis=-1)


def sunlit(position_km: Floats, sun: Floats) -> NDArray[np.bool_]:
    """Whether places (..., 3) are outside the Earth's shadow; `sun` is a unit vector (3,)."""
    along = position_km @ sun
    aside = np.linalg.norm(position_km - along[..., None] * sun, axis=-1)
    return np.asarray((along > 0) | (aside > EQUATORIAL_KM))
