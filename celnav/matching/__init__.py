"""Star identification: a family of matchers behind one protocol."""

from celnav.matching.protocol import Identification, Matcher, Observation
from celnav.matching.thesis import THESIS_ADAPTIVE, THESIS_BASELINE, DdrConfig, DdrMatcher

__all__ = [
    "THESIS_ADAPTIVE",
    "THESIS_BASELINE",
    "DdrConfig",
    "DdrMatcher",
    "Identification",
    "Matcher",
    "Observation",
]
