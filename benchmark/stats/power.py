"""Power of a comparison: the minimum detectable difference of two solvers' success on the same frames."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats
from scipy.optimize import brentq


def minimum_detectable_difference(n_frames: float, discordant: float, level: float = 0.05, power: float = 0.8) -> float:
    """Smallest true difference of two success rates that a two-sided McNemar test detects with probability `power`.

    Solves n d^2 = (z_(1 - level/2) sqrt(psi) + z_power sqrt(psi - d^2))^2 for d.

    Parameters
    ----------
    n_frames : float
        Number of frames; divided by the design effect where they come in clusters.
    discordant : float
        psi, the share of frames on which one solver succeeds and the other fails.
    level, power : float

    Returns
    -------
    float
        NaN where no difference that is possible with this share of discordant frames (at most psi) can be detected.

    References
    ----------
    R. J. Connor, Biometrics 43, 207-211, 1987, page 209: the sample size, solved for the difference.
    """
    if not 0.0 <= discordant <= 1.0 or n_frames < 0:
        raise ValueError(f"need 0 <= discordant <= 1 and frames, found {discordant} and {n_frames}")
    if n_frames == 0 or discordant == 0.0:
        return math.nan
    z_level, z_power = float(stats.norm.isf(level / 2.0)), float(stats.norm.ppf(power))

    def excess(d: float) -> float:
        wanted = z_level * math.sqrt(discordant) + z_power * math.sqrt(max(discordant - d * d, 0.0))
        return math.sqrt(n_frames) * d - wanted

    # Where all discordant frames favour one solver, the difference is their share.
    return float(brentq(excess, 0.0, discordant)) if excess(discordant) >= 0.0 else math.nan


def design_effect(gap: ArrayLike, clusters: ArrayLike) -> float:
    """Ratio of the variance of a sum of paired differences to its variance if frames within a cluster were independent.

    It is taken under the null hypothesis of no difference, as the sum of the clusters' squared sums over that of the frames'
    squares. It is not below 1, and 1 where nothing differs.

    References
    ----------
    L. Kish, Survey Sampling, 1965, section 8.2.
    """
    d = np.asarray(gap, dtype=np.float64)
    alone = float(np.sum(d**2))
    if alone == 0.0:
        return 1.0
    cluster = np.unique(np.asarray(clusters), return_inverse=True)[1]
    return max(1.0, float(np.sum(np.bincount(cluster, weights=d) ** 2)) / alone)
