"""Zenith brightness by Bortle class."""

from __future__ import annotations

BORTLE_ZENITH_MAG = {1: 21.99, 2: 21.80, 3: 21.50, 4: 21.05, 5: 20.40, 6: 19.55, 7: 18.55, 8: 17.50, 9: 16.50}
"""Zenith surface brightness of a Bortle class, V mag/arcsec^2, natural light included. Bortle's scale is visual and
published mappings differ by about 1 mag for classes 4 to 9; this table is skybench's convention (docs/physics.md)."""
