"""The diffuse sky between the horizontal and the dipped horizon of an observer in the air.

Each component is continued from its light at the horizontal, separately at each azimuth. Light from above the air is
dimmed by the additional air along the ray, with the same effective optical depth as above the horizontal, and an airglow
layer is seen as obliquely as there. Light that the air itself scatters grows as 1 - exp(-depth), towards that of
infinitely deep air.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.light.atmosphere import Atmosphere, airmass, optical_depth, scattering_depth
from generator.light.photometry import GRID_NM
from generator.places.horizon import Horizon
from generator.sky.airglow import van_rhijn
from generator.sky.component import DIFFUSE_EXTINCTION_FACTOR, Dip, SkyTable, with_dip

Floats = NDArray[np.float64]

FROM_ABOVE_THE_AIR = ("airglow", "zodiacal", "milky_way")


def dip_factors(name: str, horizon: Horizon, atmosphere: Atmosphere | None) -> Floats:
    """Radiance of a component at the horizon's `dipping_deg` over that at the horizontal, (rows, len(GRID_NM)) array."""
    factors = np.ones((len(horizon.dipping_deg), len(GRID_NM)))
    if name == "airglow":
        factors *= (van_rhijn(90 + horizon.dipping_deg) / van_rhijn(90.0))[:, None]
    if atmosphere is None:
        return factors
    depth = optical_depth(GRID_NM, atmosphere)
    level = float(airmass(0.0))
    path = (airmass(-horizon.dipping_deg) + horizon.further_airmass)[:, None]
    if name in FROM_ABOVE_THE_AIR:
        scattering = scattering_depth(GRID_NM, atmosphere)
        return factors * np.exp(-DIFFUSE_EXTINCTION_FACTOR * (path - level) * scattering)
    whole = -np.expm1(-path * depth)
    return factors * whole / np.maximum(-np.expm1(-level * depth), 1e-12)


def down_to_the_horizon(
    layers: dict[str, SkyTable], horizon: Horizon, atmosphere: Atmosphere | None
) -> dict[str, SkyTable]:
    """Return the layers of a sky, continued below the horizontal if the horizon dips."""
    if not horizon.dips:
        return layers
    return {
        name: with_dip(layer, Dip(horizon.altitude_deg, dip_factors(name, horizon, atmosphere)))
        for name, layer in layers.items()
    }
