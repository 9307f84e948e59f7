"""The radii of the Earth that the generator computes with, where the figure of the Earth does not matter.

Positions on the ellipsoid are computed by ERFA (:mod:`generator.places.astrometry`).
"""

from __future__ import annotations

MEAN_RADIUS_KM = 6371.0
"""Of the sphere of equal surface, for the curvature of the ground between a city and an observer."""
EQUATORIAL_RADIUS_KM = 6378.0
"""For thin layers of the air above the ground (airglow, cloud), as van Rhijn's formula is usually tabulated."""
