"""The DDR matcher of the thesis (section 4.iv), in all the readings that `DdrConfig` offers.

docs/thesis.md lists what the thesis leaves open, and the configuration field that decides each point.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from celnav.errors import AttitudeError
from celnav.fix import Reason
from celnav.matching.catalogue_choice import CatalogueChoice, choose_catalogues
from celnav.matching.confirmation import Alignment, align, compare_differences
from celnav.matching.history import History
from celnav.matching.patterns import Patterns, bearings, load_patterns, separations
from celnav.matching.polar import smallest_determinant
from celnav.matching.protocol import Identification, Observation
from celnav.matching.thesis_config import DdrConfig
from celnav.matching.votes import count_votes, similarities

F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _View:
    """The image's neighbours of a reference detection, nearest first."""

    reference: int
    neighbour: NDArray[np.intp]
    theta_rad: F8
    bearing_rad: F8
    enu: F8 | None


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A reference detection identified with a star of one of the catalogues."""

    view: _View
    catalogue: int
    star: int
    similarity: float
    alignment: Alignment | None
    rival_matches: int

    @property
    def n_matches(self) -> int:
        return 0 if self.alignment is None else len(self.alignment.image)


@dataclass(frozen=True)
class DdrMatcher:
    """Identifies stars by votes of distances and distance ratios around reference stars."""

    config: DdrConfig = field(default_factory=DdrConfig)

    def identify(self, observation: Observation, history: History | None = None) -> Identification:
        """Identify the stars; see `celnav.matching.Matcher`."""
        config = self.config
        catalogues = load_patterns(config.patterns)
        kept = self._brightest(observation, catalogues)
        rays = observation.rays[kept]
        if len(rays) < config.min_features + 1:
            return Identification(
                Reason.TOO_FEW_DETECTIONS,
                f"{len(rays)} detections; the matcher needs a reference star and {config.min_features} neighbours",
            )
        needs_attitude = config.reject_polar_deg is not None and config.polar_criterion == "determinant"
        if needs_attitude and observation.R_cam is None:
            raise AttitudeError(
                "polar rejection by the determinant needs the attitude; polar_criterion='declination' does not"
            )
        middle = np.array([(observation.camera.width - 1) / 2, (observation.camera.height - 1) / 2])
        central = np.argsort(np.linalg.norm(observation.uv[kept] - middle, axis=1), kind="stable")
        choice = choose_catalogues(rays, central, catalogues, config, history)
        order = central
        if config.reference_order == "brightness" and observation.flux is not None:
            order = np.argsort(-observation.flux[kept], kind="stable")
        best = self._search(rays, order, catalogues, choice, observation.R_cam)
        if best is None:
            return Identification(Reason.NO_HYPOTHESIS, "no reference star has enough neighbours, or only polar ones")
        return self._conclude(best, kept, catalogues, history)

    def _brightest(self, observation: Observation, catalogues: tuple[Patterns, ...]) -> NDArray[np.intp]:
        """Return the rows of the detections to use: the brightest if fluxes are known."""
        config = self.config
        everything = np.arange(len(observation.uv))
        if not config.brightest or observation.flux is None:
            return everything
        if config.brightest_count is not None:
            return np.argsort(-observation.flux, kind="stable")[: config.brightest_count]
        fixed = config.fixed_limit_decimag
        deepest = catalogues[-1 if fixed is None else config.patterns.limits_decimag.index(fixed)]
        share_of_sky = observation.camera.solid_angle_sr / (4 * np.pi)
        n = max(config.min_features + 1, round(config.brightest_factor * len(deepest) * share_of_sky))
        return np.argsort(-observation.flux, kind="stable")[:n]

    def _search(
        self,
        rays: F8,
        order: NDArray[np.intp],
        catalogues: tuple[Patterns, ...],
        choice: CatalogueChoice,
        R_cam: F8 | None,
    ) -> _Hypothesis | None:
        """Try reference stars in order until one is similar enough; otherwise return the best one."""
        config = self.config
        limit = 1 if not config.iterate else (config.max_references or len(order))
        best: _Hypothesis | None = None
        for reference in order[:limit]:
            view = self._view(rays, int(reference), R_cam)
            if len(view.neighbour) < config.min_features:
                continue
            found = self._best_of_catalogues(view, catalogues, choice)
            if found is None:
                continue
            if found.similarity >= config.similarity_threshold and self._confirmed(found, catalogues):
                return found
            if best is None or (found.n_matches, found.similarity) > (best.n_matches, best.similarity):
                best = found
        return best

    def _view(self, rays: F8, reference: int, R_cam: F8 | None) -> _View:
        theta = separations(rays[reference], rays)
        within = np.flatnonzero(theta <= np.radians(self.config.patterns.radius_deg))
        within = within[within != reference]
        within = within[np.argsort(theta[within], kind="stable")]
        enu = None if R_cam is None else rays[reference] @ R_cam
        return _View(reference, within, theta[within], bearings(rays[reference], rays[within]), enu)

    def _best_of_catalogues(
        self, view: _View, catalogues: tuple[Patterns, ...], choice: CatalogueChoice
    ) -> _Hypothesis | None:
        """Probe the catalogues: the highest similarity wins, unless that of the consensus catalogue comes close."""
        config = self.config
        votes = [count_votes(view.theta_rad, catalogues[row], config) for row in choice.probed]
        scores = [
            similarities(vote, len(view.neighbour), catalogues[row], config)
            for vote, row in zip(votes, choice.probed, strict=True)
        ]
        similarity = np.array([score.max(initial=0) for score in scores])
        best = int(np.argmax(similarity))
        if choice.consensus in choice.probed:
            preferred = choice.probed.index(choice.consensus)
            if similarity[preferred] >= similarity[best] - config.consensus_margin:
                best = preferred
        return self._best_star(view, choice.probed[best], catalogues[choice.probed[best]], scores[best])

    def _best_star(self, view: _View, row: int, catalogue: Patterns, similarity: F8) -> _Hypothesis | None:
        """Confirm the most similar stars by bearings; the star with most agreeing neighbours wins."""
        config = self.config
        by_votes_alone = config.bearings == "ignored"
        affordable = max(1, min(config.candidates, config.effort // len(view.neighbour)))
        found: list[_Hypothesis] = []
        for star in np.argsort(-similarity, kind="stable")[: 1 if by_votes_alone else affordable]:
            alignment = None if by_votes_alone else self._align(view, catalogue, int(star))
            found.append(_Hypothesis(view, row, int(star), float(similarity[star]), alignment, 0))
        if not found:
            return None
        found.sort(key=lambda hypothesis: (-hypothesis.n_matches, -hypothesis.similarity))
        best = found[0]
        # A polar star makes way for another reference star, not for the next candidate.
        if self._polar(view, float(catalogue.dec_rad[best.star])):
            return None
        rivals = [h.n_matches for h in found[1:] if not self._same_place(catalogue, best.star, h.star)]
        return _Hypothesis(view, row, best.star, best.similarity, best.alignment, max(rivals, default=0))

    def _polar(self, view: _View, dec_rad: float) -> bool:
        """Return whether a reference star with this declination is to be rejected for its position in the sky."""
        limit = self.config.reject_polar_deg
        if limit is None:
            return False
        if self.config.polar_criterion == "determinant" and view.enu is not None:
            return smallest_determinant(view.enu, dec_rad) < float(np.cos(np.radians(limit)))
        return abs(float(np.degrees(dec_rad))) > limit

    def _same_place(self, catalogue: Patterns, star: int, other: int) -> bool:
        """Return whether two stars are closer than the match tolerance, like the components of a double star."""
        rows = slice(catalogue.start[star], catalogue.start[star + 1])
        close = catalogue.neighbour[rows][catalogue.theta_rad[rows] <= np.radians(self.config.match_tolerance_deg)]
        return bool((close == other).any())

    def _align(self, view: _View, catalogue: Patterns, star: int) -> Alignment:
        rows = slice(catalogue.start[star], catalogue.start[star + 1])
        theta, bearing = catalogue.theta_rad[rows].astype(np.float64), catalogue.bearing_rad[rows].astype(np.float64)
        tolerance = float(np.radians(self.config.match_tolerance_deg))
        if self.config.bearings == "sorted-differences":
            return compare_differences(view.theta_rad, view.bearing_rad, theta, bearing, tolerance)
        radius = float(np.radians(self.config.patterns.radius_deg))
        return align(view.theta_rad, view.bearing_rad, theta, bearing, tolerance, radius)

    def _confirmed(self, found: _Hypothesis, catalogues: tuple[Patterns, ...]) -> bool:
        if self.config.bearings == "ignored":
            return True
        if found.alignment is None or found.n_matches < self.config.min_matches:
            return False
        all_stars = np.log10(len(catalogues[found.catalogue]))
        return bool(found.alignment.log10_false_alarm + all_stars <= self.config.max_log10_false_alarm)

    def _conclude(
        self, best: _Hypothesis, kept: NDArray[np.intp], catalogues: tuple[Patterns, ...], history: History | None
    ) -> Identification:
        """Turn the best hypothesis into an identification or a refusal."""
        config = self.config
        limit = config.patterns.limits_decimag[best.catalogue]
        details: dict[str, float | int | str] = {
            "catalogue_limit_mag": limit / 10,
            "reference_detection": int(kept[best.view.reference]),
            "neighbours": len(best.view.neighbour),
            "neighbours_matched": best.n_matches,
        }
        too_low = best.similarity < config.similarity_threshold and config.below_threshold == "refuse"
        if too_low or not self._confirmed(best, catalogues):
            return Identification(
                Reason.NO_HYPOTHESIS,
                f"no reference star is identified: at best {best.n_matches} of {len(best.view.neighbour)} neighbours "
                f"agree, similarity {best.similarity:.2f}",
                confidence=best.similarity,
                details=details,
            )
        if config.bearings != "ignored" and best.rival_matches > 0.8 * best.n_matches:
            return Identification(
                Reason.AMBIGUOUS, "two stars explain the reference star about equally well", details=details
            )
        catalogue = catalogues[best.catalogue]
        matches = [[kept[best.view.reference], catalogue.star_id[best.star]]]
        if best.alignment is not None and config.stars_in_fix == "all":
            neighbours = catalogue.neighbour[catalogue.start[best.star] + best.alignment.pattern]
            pairs = np.column_stack((kept[best.view.neighbour[best.alignment.image]], catalogue.star_id[neighbours]))
            matches.extend(pairs.tolist())
        if history is not None:
            history.record(limit, best.similarity)
        return Identification(
            Reason.OK,
            matches=np.array(matches, dtype=np.int64),
            confidence=min(best.similarity, 1.0),
            details=details,
        )
