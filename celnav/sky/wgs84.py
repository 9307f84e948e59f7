"""The Earth's figure and rotation: WGS84 (NIMA TR8350.2, third edition), and its mean radius."""

SEMI_MAJOR_AXIS_KM = 6378.137
ECCENTRICITY_SQUARED = 6.69437999014e-3
ROTATION_RAD_S = 7.292115e-5
"""Rotation rate relative to the stars, per second of UT1."""
# Mean radius (2a + b)/3, rounded: accurate to 0.3 % everywhere, for distances that need no more.
MEAN_RADIUS_KM = 6371.0
