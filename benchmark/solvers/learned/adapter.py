"""Adapter for star identification by a network trained on simulated detections; the vertical gives the position."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.protocol import Answer, Detections, Observation
from benchmark.provenance import distribution_version
from benchmark.solvers.attitude_position import position_of_attitude, rays_of_fit
from benchmark.solvers.learned.identification import Sky, identify
from benchmark.solvers.learned.network import trained_network
from benchmark.solvers.learned.patterns import MOST_DETECTIONS, patterns_of
from benchmark.solvers.pinhole import pinhole_view
from benchmark.solvers.star_naming import EPOCH_JYEAR
from celnav.sky.catalog import load_catalog, propagate

FAINTEST_V = 6.5
"""Magnitude limit of the stars with which an attitude is compared."""
FEWEST_DETECTIONS = 4


@dataclass(frozen=True)
class Learned:
    """Solver whose network names patterns of the brightest detections; names are accepted where their angles agree."""

    name = "learned"
    detector = "celnav"

    @property
    def version(self) -> str:
        """Version of the skybench distribution, which contains it."""
        return distribution_version()

    def detect(self, image: NDArray[np.uint16]) -> Detections:
        """Run celnav's default detector: the network was published without one."""
        found: Detections = celnav.detect(image)
        return found

    def solve(self, detections: Detections, observation: Observation) -> Answer:
        """Identify the stars, and convert the attitude to a position."""
        uv = np.asarray(detections.uv)
        brightness = np.ones(len(uv)) if detections.flux is None else np.asarray(detections.flux)
        brightest = np.argsort(-brightness, kind="stable")[:MOST_DETECTIONS]
        view = pinhole_view(uv[brightest], observation.camera)
        if len(view.rows) < FEWEST_DETECTIONS:
            return Answer(ok=False, reason=f"fewer than {FEWEST_DETECTIONS} detections")
        shown = brightest[view.rows]
        magnitudes = -2.5 * np.log10(np.maximum(brightness[shown], 1e-9))
        named, sky, star_ids = _stars()
        found = identify(view, trained_network().probabilities(patterns_of(view.rays, magnitudes)), named, sky)
        if found is None:
            return Answer(ok=False, reason="no names that agree with enough stars")
        matched = shown[found.detections]
        up = observation.R_cam[:, 2]
        seen = rays_of_fit(observation.camera, uv[matched], up)
        lat, lon = position_of_attitude(
            found.rotation, up, observation.utc, seen, observation.pressure_hpa, observation.temperature_c
        )
        matches = np.column_stack((matched, star_ids[found.stars])).astype(np.int64)
        return Answer(ok=True, lat_deg=lat, lon_deg=lon, confidence=1.0 - found.chance, matches=matches)


@lru_cache(maxsize=1)
def _stars() -> tuple[NDArray[np.float64], Sky, NDArray[np.int64]]:
    """Directions of the stars that the network knows, the sky for verification, and its star ids."""
    stars = load_catalog()
    bright = stars.take(stars.v_mag < FAINTEST_V)
    known = stars.take(stars.rows_of(trained_network().star_ids))
    directions = [
        places / np.linalg.norm(places, axis=1, keepdims=True)
        for places in (propagate(each.vectors, each.motion, EPOCH_JYEAR - each.epoch_jyear) for each in (known, bright))
    ]
    return directions[0], Sky(directions[1]), bright.star_id.astype(np.int64)
