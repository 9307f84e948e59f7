"""One deep catalogue and the N brightest detections: the plain alternative to selecting a catalogue.

The brightest detections of any frame, under a dark or bright sky, are bright stars, so a catalogue deep enough to contain
them all needs no knowledge of the sky. Votes are divided by the number of features in the image, so stars that only the
catalogue has cost nothing. They would, however, shift theta_max, the farthest neighbour; rho is therefore taken relative to
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
