"""The thesis' reported numbers ("UAV Celestial Navigation with Light Pollution Adaptation", section 5)."""

from __future__ import annotations

from dataclasses import dataclass

N_FRAMES = 200
# Limiting magnitudes of the nine sets, and the Bortle classes that the thesis assigns to them.
LABELS_MAG = (8.0, 7.5, 7.0, 6.5, 6.0, 5.5, 5.0, 4.5, 4.0)
TABLE_LABEL_MAG = 7.0
# Figure 5: recall in percent, class 1 to 9. Class 9 is "both algorithms fail".
ADAPTIVE_RECALL = (82.5, 81.0, 71.5, 71.5, 61.0, 49.0, 27.6, 4.5, 0.0)
BASELINE_RECALL = (74.5, 71.0, 39.0, 3.0, 2.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Configuration:
    """A row of Table 1.1: recall (percent), time per frame (s), median error (km)."""

    name: str
    recall: float
    time_s: float
    median_km: float


@dataclass(frozen=True)
class ConfidenceBin:
    """A row of Table 1.2: bounds of the confidence, frames, median error (km), share of errors >= 10 km (percent)."""

    low: float
    high: float
    count: int
    median_km: float
    failures: float


TABLE_1_1 = (
    Configuration("Baseline", 39.0, 5.64, 13.80),
    Configuration("Baseline + SI", 42.5, 47.21, 11.96),
    Configuration("Baseline + SI + PR", 41.5, 52.62, 10.47),
    Configuration("Adaptive", 71.5, 5.23, 6.80),
)
TABLE_1_2 = (
    ConfidenceBin(0.0, 0.4, 1, 5875.8, 100.0),
    ConfidenceBin(0.4, 0.6, 71, 6.87, 33.8),
    ConfidenceBin(0.6, 0.8, 104, 7.11, 24.0),
    ConfidenceBin(0.8, 1.01, 24, 7.31, 29.2),
)
MEDIAN_KM = TABLE_1_1[-1].median_km
"""Median error of the adaptive configuration."""
