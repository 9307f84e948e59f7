"""Choice of the catalogues to search: density, neighbours, and the consensus of earlier frames (the thesis, section 4.iv)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celnav.matching.history import History
from celnav.matching.patterns import Patterns
from celnav.matching.thesis_config import DdrConfig

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class CatalogueChoice:
    """Rows of the catalogues to probe, in order of depth, and the consensus catalogue if there is one."""

    probed: tuple[int, ...]
    consensus: int | None = None


def choose_catalogues(
    rays: F8,
    central: NDArray[np.intp],
    catalogues: tuple[Patterns, ...],
    config: DdrConfig,
    history: History | None,
) -> CatalogueChoice:
    """Choose the catalogues with which a frame is compared.

    Parameters
    ----------
    rays : ndarray, shape (n, 3)
        Unit vectors of the detections.
    central : ndarray of int, shape (n,)
        Rows of the detections, the most central first.
    catalogues : tuple of Patterns
        The catalogues, in order of depth.
    config : DdrConfig
        Settings of fixed catalogue, density, probing and consensus.
    history : History or None
        Matches of earlier frames.
    """
    limits = config.patterns.limits_decimag
    if config.fixed_limit_decimag is not None:
        return CatalogueChoice((limits.index(config.fixed_limit_decimag),))
    consensus = None
    if history is not None:
        agreed = history.consensus(config.consensus_min_matches, config.consensus_min_similarity)
        if agreed is not None and agreed[0] in limits:
            consensus = limits.index(agreed[0])
            if agreed[1] > config.consensus_fast_share:
                return CatalogueChoice((consensus,), consensus)
    near = nearest_density(observed_density(rays, central, config), catalogues)
    probed = set(range(max(0, near - config.probe_steps), min(len(catalogues), near + config.probe_steps + 1)))
    if consensus is not None:
        probed.add(consensus)
    return CatalogueChoice(tuple(sorted(probed)), consensus)


def observed_density(rays: F8, central: NDArray[np.intp], config: DdrConfig) -> float:
    """Return the median or mean number of detections within the radius of the most central ones."""
    references = rays[central[: config.density_references]]
    counts = np.count_nonzero(references @ rays.T >= np.cos(np.radians(config.patterns.radius_deg)), axis=1) - 1
    return float(np.median(counts) if config.density_statistic == "median" else np.mean(counts))


def nearest_density(density: float, catalogues: tuple[Patterns, ...]) -> int:
    """Return the row of the catalogue whose mean neighbour count is nearest in the logarithm."""
    expected = np.array([catalogue.mean_neighbours for catalogue in catalogues])
    return int(np.argmin(np.abs(np.log(np.maximum(expected, 1e-3)) - np.log(max(density, 0.5)))))
