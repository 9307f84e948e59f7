"""Quantum efficiencies by name: ``sensor: {quantum_efficiency: cmos-mono}``."""

from __future__ import annotations

QE_CURVES: dict[str, tuple[tuple[float, float], ...]] = {
    "cmos-mono": (
        (350, 0.30), (400, 0.58), (450, 0.74), (500, 0.81), (550, 0.80), (600, 0.74), (650, 0.65), (700, 0.54),
        (750, 0.43), (800, 0.33), (850, 0.24), (900, 0.16), (950, 0.09), (1000, 0.04),
    ),
    "cmos-mono-front": (
        (350, 0.12), (400, 0.38), (450, 0.60), (500, 0.69), (525, 0.71), (550, 0.70), (600, 0.63), (650, 0.53),
        (700, 0.41), (750, 0.29), (800, 0.19), (850, 0.12), (900, 0.07), (950, 0.03), (1000, 0.01),
    ),
    "cmos-red": (
        (350, 0.02), (400, 0.03), (450, 0.02), (500, 0.03), (550, 0.05), (575, 0.16), (590, 0.52), (600, 0.60),
        (625, 0.58), (650, 0.53), (675, 0.45), (690, 0.22), (700, 0.08), (710, 0.02), (720, 0),
    ),
    "cmos-green": (
        (350, 0.02), (400, 0.03), (450, 0.08), (475, 0.24), (500, 0.50), (525, 0.65), (540, 0.66), (550, 0.63),
        (575, 0.44), (600, 0.17), (625, 0.07), (650, 0.06), (675, 0.08), (690, 0.05), (700, 0.02), (720, 0),
    ),
    "cmos-blue": (
        (350, 0.05), (390, 0.20), (400, 0.32), (425, 0.50), (450, 0.58), (475, 0.50), (500, 0.26), (525, 0.10),
        (550, 0.04), (600, 0.02), (650, 0.02), (690, 0.02), (720, 0),
    ),
}  # fmt: skip
"""Points (nm, 0-1), linear in between. The curves are skybench's own: ``cmos-mono`` is a generic back-illuminated
monochrome CMOS, the coloured ones are its Bayer filters behind an infrared cut-off at 700 nm, and ``cmos-mono-front`` is a
front-illuminated global-shutter CMOS with pixels of 3.45 um, whose scale is the 70 % at 545 nm that Basler states for its
acA4112-30u ("About EMVA1288 Reports for Color Sensors", docs.baslerweb.com)."""
