"""Refraction in an orientation that was found without a vertical, and its removal once the vertical is known.

Refraction lifts every star towards the zenith. Without a vertical it cannot be removed from the stars, and it tilts the
orientation that they give: by the mean lift over the frame, 0.02 to 0.03 deg for a camera 50 to 30 deg above the horizon.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.position import Weather
from celnav.sky.refraction import unrefract_rays

F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LiftedSky:
    """Stars whose refraction an orientation still contains.

    Attributes
    ----------
    rays : ndarray, shape (n, 3)
        Unit vectors in the camera frame at which the stars were seen.
    weights : ndarray, shape (n,)
        Weight of each star in the orientation.
    weather : Weather
        The air.
    relative_sigma : float
        Relative standard deviation of the refraction.
    """

    rays: F8
    weights: F8
    weather: Weather
    relative_sigma: float

    def turn(self, up: F8) -> F8:
        """Return the rotation vector, camera frame, radians, that removes the refraction from the orientation.

        It minimises the weighted squares of w x r - (t - r) over the stars, where r is seen and t is without refraction.

        Parameters
        ----------
        up : ndarray, shape (3,)
            Zenith, camera frame.
        """
        without = unrefract_rays(self.rays, up, self.weather.pressure_hpa, self.weather.temperature_c)
        across = np.einsum("n,ni,nj->ij", self.weights, self.rays, self.rays)
        normal = self.weights.sum() * np.eye(3) - across
        return np.asarray(np.linalg.solve(normal, self.weights @ np.cross(self.rays, without - self.rays)))
