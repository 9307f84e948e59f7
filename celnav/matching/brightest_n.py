"""One deep catalogue and the N brightest detections: the plain alternative to selecting a catalogue.

The brightest detections of any frame, dark or bright sky, are bright stars, so that a catalogue deep enough to hold them
all needs no knowledge of the sky. Votes are then divided by the number of the image's features: stars that only the
catalogue has cost nothing. What they would shift is theta_max, the farthest neighbour, which is why rho is taken against
the radius here.
"""

from __future__ import annotations

from celnav.matching.patterns import PatternConfig
from celnav.matching.thesis_config import DdrConfig

BRIGHTEST_N = DdrConfig(
    patterns=PatternConfig(limits_decimag=(45,), theta_max="radius"),
    fixed_limit_decimag=45,
    brightest_count=50,
    similarity_threshold=0.45,
    reject_polar_deg=None,
)
