"""Votes of an image's features for the stars of a catalogue, and the resulting similarity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from celnav.matching.patterns import Patterns
from celnav.matching.thesis_config import DdrConfig

F8 = NDArray[np.float64]


def count_votes(theta_rad: F8, catalogue: Patterns, config: DdrConfig) -> NDArray[np.int64]:
    """Count the image's features that each star of a catalogue shares.

    Parameters
    ----------
    theta_rad : ndarray, shape (n,)
        Distances of the image's neighbours, in ascending order.
    catalogue : Patterns
        The catalogue with its look-up table.
    config : DdrConfig
        Bins, tolerance, theta_max.

    Returns
    -------
    ndarray of int64, shape (len(catalogue),)
        Votes; a feature gives a star at most one.
    """
    patterns = config.patterns
    farthest = float(theta_rad[-1]) if patterns.theta_max == "pattern" else float(np.radians(patterns.radius_deg))
    rho = theta_rad / max(farthest, 1e-12)
    if config.tolerance_bins == 0:
        return catalogue.votes(patterns.bins(theta_rad, rho))
    own = patterns.bins(theta_rad, rho)
    steps = np.arange(-config.tolerance_bins, config.tolerance_bins + 1)
    theta_bin = own[:, None, None] // patterns.n_rho + steps[None, :, None]
    rho_bin = own[:, None, None] % patterns.n_rho + steps[None, None, :]
    inside = (theta_bin >= 0) & (theta_bin < patterns.n_theta) & (rho_bin >= 0) & (rho_bin < patterns.n_rho)
    feature = np.broadcast_to(np.arange(len(own))[:, None, None], inside.shape)[inside]
    stars, source = catalogue.stars_in((theta_bin * patterns.n_rho + rho_bin)[inside])
    once = np.unique(feature[source] * len(catalogue) + stars)
    return np.bincount(once % len(catalogue), minlength=len(catalogue)).astype(np.int64)


def similarities(votes: NDArray[np.int64], n_features: int, catalogue: Patterns, config: DdrConfig) -> F8:
    """Normalise votes, shape (len(catalogue),), by the number of features."""
    if config.vote_normalisation == "image":
        return np.asarray(votes / n_features)
    size = np.maximum(np.diff(catalogue.start), 1).astype(np.float64)
    if config.vote_normalisation == "larger":
        size = np.maximum(size, n_features)
    return np.asarray(votes / size)
