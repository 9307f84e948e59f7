"""Star identification: a family of matchers behind one protocol."""

from celnav.matching.brightest_n import BRIGHTEST_N
from celnav.matching.ddr_dai import DaiConfig, DaiMatcher
from celnav.matching.patterns import EXTENDED_PATTERNS, PatternConfig
from celnav.matching.protocol import Identification, Matcher, Observation
from celnav.matching.thesis import DdrMatcher
from celnav.matching.thesis_config import (
    THESIS_ADAPTIVE,
    THESIS_BASELINE,
    THESIS_BASELINE_SI,
    THESIS_BASELINE_SI_PR,
    THESIS_CATALOGUE_ONLY,
    DdrConfig,
)

__all__ = [
    "BRIGHTEST_N",
    "EXTENDED_PATTERNS",
    "THESIS_ADAPTIVE",
    "THESIS_BASELINE",
    "THESIS_BASELINE_SI",
    "THESIS_BASELINE_SI_PR",
    "THESIS_CATALOGUE_ONLY",
    "DaiConfig",
    "DaiMatcher",
    "DdrConfig",
    "DdrMatcher",
    "Identification",
    "Matcher",
    "Observation",
    "PatternConfig",
]
