"""Radii of the Earth for computations in which its figure does not matter.

Positions on the ellipsoid are computed by ERFA (:mod:`generator.places.astrometry`).
"""

from __future__ import annotations

MEAN_RADIUS_KM = 6371.0
"""Radius of the sphere of equal surface, for the curvature of the ground between a city and an observer."""
EQUATORIAL_RADIUS_KM = 6378.0
"""Radius for thin layers of the air above the ground (airglow, cloud), with which van Rhijn's formula is usually
tabulated."""
