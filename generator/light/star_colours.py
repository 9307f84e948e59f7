"""V-I of stars for which no catalogue states it: from B-V, luminosity and spectral type."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Synthetic colours (Johnson B-V, Cousins V-I) of the templates of Pickles 1998, PASP 110, 863, by
# generator.light.photometry. Where the library's templates of K giants scatter (K3 to K5), their mean is used.
# Supergiants and bright giants (M3 II, M2 I) continue the giants beyond B-V 1.5.
_DWARFS_BV = [-0.38, -0.34, -0.24, -0.20, -0.14, -0.05, 0.01, 0.10, 0.16, 0.21, 0.31, 0.47, 0.55, 0.58, 0.69, 0.76, 0.94,
              1.10, 1.22, 1.37, 1.46, 1.53, 1.60, 1.67, 1.82]  # fmt: skip
_DWARFS_VI = [-0.35, -0.30, -0.23, -0.14, -0.06, -0.01, 0.03, 0.12, 0.18, 0.27, 0.40, 0.52, 0.64, 0.70, 0.78, 0.85, 1.01,
              1.27, 1.40, 1.69, 2.08, 2.52, 2.87, 3.25, 3.83]  # fmt: skip
_GIANTS_BV = [-0.33, -0.26, -0.19, -0.15, -0.08, 0.03, 0.14, 0.18, 0.22, 0.27, 0.43, 0.67, 0.90, 0.97, 1.05, 1.12, 1.22,
              1.43, 1.66, 1.74]  # fmt: skip
_GIANTS_VI = [-0.35, -0.24, -0.15, -0.08, -0.04, 0.03, 0.10, 0.19, 0.27, 0.35, 0.48, 0.77, 0.91, 1.02, 1.09, 1.18, 1.22,
              1.49, 2.20, 2.32]  # fmt: skip
M_GIANTS_VI: Floats = np.array([1.71, 1.82, 1.94, 2.17, 2.50, 2.90, 3.38, 4.02, 4.36])
"""V-I of giants M0 to M8, from the same templates; their B-V hardly changes."""
GIANT_REDUCED_MOTION_MAG = 8.0
"""Reduced proper motion, V + 5 + 5 log10(proper motion in arcsec/yr): red stars above this are dwarfs. A tangential speed of
47 km/s makes it the absolute magnitude plus 5, so that giants (absolute magnitude 1 and less) need 120 km/s to exceed it and
dwarfs of type K (6 and more) 12 km/s. Source of the method: Jones 1972, ApJ 173, 671."""


def usual_vi(bv_mag: ArrayLike, dwarf: ArrayLike | None = None) -> Floats:
    """V-I (Cousins) of stars without interstellar reddening from their B-V.

    Parameters
    ----------
    bv_mag : (m,) array_like
    dwarf : (m,) array_like of bool, or None
        Whether the stars are dwarfs; None means those up to B-V 0.8, the limit of most dwarfs visible to the naked eye.
    """
    bv = np.asarray(bv_mag, float)
    is_dwarf = bv < 0.8 if dwarf is None else np.asarray(dwarf, bool)
    return np.where(is_dwarf, np.interp(bv, _DWARFS_BV, _DWARFS_VI), np.interp(bv, _GIANTS_BV, _GIANTS_VI))


def moves_like_a_dwarf(v_mag: Floats, motion_mas_yr: Floats) -> NDArray[np.bool_]:
    """Whether stars have such a large proper motion for their magnitude that they must be nearby, and hence dwarfs."""
    with np.errstate(divide="ignore"):
        return v_mag + 5 + 5 * np.log10(motion_mas_yr / 1000) > GIANT_REDUCED_MOTION_MAG


def vi_from_type(bv_mag: Floats, spectral_type: NDArray[np.str_], dwarf: NDArray[np.bool_]) -> Floats:
    """V-I of stars from B-V, and from the subtype of M giants; types begin like "K5" or "M3", or are empty."""
    vi = usual_vi(bv_mag, dwarf | (bv_mag < 0.8))
    subtype = np.array([int(text[1]) if text[:1] == "M" and text[1:2].isdigit() else -1 for text in spectral_type])
    giant = (subtype >= 0) & ~dwarf
    return np.where(giant, M_GIANTS_VI[np.clip(subtype, 0, len(M_GIANTS_VI) - 1)], vi)
