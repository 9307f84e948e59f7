"""Directions of the naked-eye planets, which are often the brightest lights of a frame.

The source is Simon et al. 1994, Astron. Astrophys. 282, 663, in the form of ERFA's ``plan94`` (accurate from arcseconds to an
arcminute over the years 1000 to 3000), with light time and aberration. This is too coarse for a fix, which leaves planets
out.
"""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import NDArray

from celnav.sky.astrometry import AU_PER_DAY_IN_C, aberrate, earth_at
from celnav.sky.utc import Utc

F8 = NDArray[np.float64]

# Numbers as in plan94; 3 is the Earth-Moon barycentre.
PLANETS = {1: "Mercury", 2: "Venus", 4: "Mars", 5: "Jupiter", 6: "Saturn"}
# Planet k has the star id -(FIRST_PLANET_ID + k), beyond all HR numbers.
FIRST_PLANET_ID = 1_000_000
ACCURACY_RAD = np.radians(1.0 / 60.0)


def planet_name(star_id: int) -> str | None:
    """Return the name of the planet with a star id, or None for a star."""
    return PLANETS.get(-int(star_id) - FIRST_PLANET_ID)


def planet_ids() -> NDArray[np.int64]:
    """Return the star ids of the planets, in the order of `planet_directions`."""
    return np.array([-(FIRST_PLANET_ID + number) for number in PLANETS], dtype=np.int64)


def planet_directions(utc: Utc) -> F8:
    """Return the apparent geocentric directions of the planets, GCRS with aberration, shape (5, 3)."""
    tt1, tt2 = utc.tt
    earth = earth_at(utc)
    numbers = np.array(list(PLANETS), dtype=np.int32)
    seen, late_days = np.zeros((len(numbers), 3)), np.zeros(len(numbers))
    for _ in range(2):
        seen = np.asarray(erfa.plan94(tt1, tt2 - late_days, numbers)["p"]) - earth.heliocentric
        late_days = np.linalg.norm(seen, axis=1) * AU_PER_DAY_IN_C
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    return aberrate(seen, earth.beta)
