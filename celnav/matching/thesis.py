"""The DDR matcher of the thesis (section 4.iv and the configurations of section 5).

What the thesis leaves open is a named field of `DdrConfig`; docs/celnav.md says which of them are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from celnav.errors import ConfigError
from celnav.fix import Reason
from celnav.history import History
from celnav.matching.confirmation import Alignment, align
from celnav.matching.patterns import PatternConfig, Patterns, bearings, load_patterns, separations
from celnav.matching.protocol import Identification, Observation

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class DdrConfig:
    """Choices of the DDR matcher. Frozen and hashable.

    Attributes
    ----------
    patterns : PatternConfig
        Catalogues, neighbour radius and bins.
    fixed_limit_decimag : int or None
        Use this catalogue alone (the thesis' baseline: 40); None selects among all.
    probe_steps : int
        Catalogues on either side of the density's that are probed.
    density_references : int
        The density is the median neighbour count of this many most central detections.
    iterate : bool
        Similarity iteration: go on to further reference stars while the similarity is below `similarity_threshold`.
    similarity_threshold : float
        tau_c of the thesis.
    max_references : int or None
        Reference stars that the iteration may try; None: all detections.
    reject_polar_deg : float or None
        A reference star with |declination| above this is not accepted; None accepts all.
    tolerance_bins : int
        A feature votes for its own bin and this many on either side in theta and rho.
    candidates : int
        The stars with most votes that are confirmed by bearings; 1 takes the vote's word.
    effort : int
        At most this many neighbours times candidates are confirmed for a reference star: among thousands of detections
        fewer candidates are looked at, instead of taking more time.
    confirm_by_bearing : bool
        Confirm candidates by relative bearings. Without it the votes decide alone and the reference star is the only
        match.
    match_tolerance_deg : float
        Distance within which a neighbour in the image and one in the pattern fall together.
    max_log10_false_alarm : float
        A candidate is confirmed when chance would do as well with at most this probability (decimal logarithm, all
        stars of the catalogue and all rotations counted).
    min_matches : int
        Neighbours that must agree.
    min_features : int
        Neighbours that a reference star must have.
    brightest : bool
        Where fluxes are known, keep the brightest detections only, as many as the deepest catalogue has stars in the
        camera's solid angle, on the mean of the sky.
    brightest_factor : float
        Times this.
    consensus_min_matches : int
        Good matches in the history that make a consensus.
    consensus_min_similarity : float
        Similarity of a good match.
    consensus_margin : float
        The consensus catalogue overrides the best one when its similarity is at most this much lower.
    consensus_fast_share : float
        Above this share of the good matches the consensus catalogue is used without probing.
    stars_in_fix : str
        ``all``: all confirmed matches (equation 3.10); ``one``: the reference star alone (section 4.v).
    """

    patterns: PatternConfig = field(default_factory=PatternConfig)
    fixed_limit_decimag: int | None = None
    probe_steps: int = 1
    density_references: int = 5
    iterate: bool = True
    similarity_threshold: float = 0.45
    max_references: int | None = 30
    reject_polar_deg: float | None = 75.0
    tolerance_bins: int = 0
    candidates: int = 30
    effort: int = 6000
    confirm_by_bearing: bool = True
    match_tolerance_deg: float = 0.5
    max_log10_false_alarm: float = -4.0
    min_matches: int = 3
    min_features: int = 4
    brightest: bool = True
    brightest_factor: float = 1.0
    consensus_min_matches: int = 5
    consensus_min_similarity: float = 0.6
    consensus_margin: float = 0.05
    consensus_fast_share: float = 0.8
    stars_in_fix: Literal["all", "one"] = "all"

    def __post_init__(self) -> None:
        if self.fixed_limit_decimag is not None and self.fixed_limit_decimag not in self.patterns.limits_decimag:
            raise ConfigError(f"fixed_limit_decimag = {self.fixed_limit_decimag} is none of the catalogues' limits")
        if self.candidates < 1 or self.min_features < 2 or self.min_matches < 1:
            raise ConfigError("the DDR matcher needs candidates >= 1, min_features >= 2 and min_matches >= 1")


@dataclass(frozen=True, eq=False)
class _View:
    """The image's neighbours of a reference detection, nearest first."""

    reference: int
    neighbour: NDArray[np.intp]
    theta_rad: F8
    bearing_rad: F8


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
        """Identify; see `celnav.matching.Matcher`."""
        config = self.config
        catalogues = load_patterns(config.patterns)
        kept = self._brightest(observation, catalogues)
        rays = observation.rays[kept]
        if len(rays) < config.min_features + 1:
            return Identification(
                Reason.TOO_FEW_DETECTIONS,
                f"{len(rays)} detections; the matcher needs a reference star and {config.min_features} neighbours",
            )
        middle = np.array([(observation.camera.width - 1) / 2, (observation.camera.height - 1) / 2])
        central = np.argsort(np.linalg.norm(observation.uv[kept] - middle, axis=1), kind="stable")
        choices, consensus = self._catalogues(rays, central, catalogues, history)
        best = self._search(rays, central, catalogues, choices, consensus)
        if best is None:
            return Identification(Reason.NO_HYPOTHESIS, "no reference star has enough neighbours, or only polar ones")
        return self._conclude(best, kept, catalogues, history)

    def _brightest(self, observation: Observation, catalogues: tuple[Patterns, ...]) -> NDArray[np.intp]:
        """Rows of the detections to use: the brightest where fluxes are known."""
        config = self.config
        everything = np.arange(len(observation.uv))
        if not config.brightest or observation.flux is None:
            return everything
        deepest = catalogues[-1 if config.fixed_limit_decimag is None else self._index(config.fixed_limit_decimag)]
        share_of_sky = observation.camera.solid_angle_sr / (4 * np.pi)
        n = max(config.min_features + 1, round(config.brightest_factor * len(deepest) * share_of_sky))
        return np.argsort(-observation.flux, kind="stable")[:n]

    def _index(self, limit_decimag: int) -> int:
        return self.config.patterns.limits_decimag.index(limit_decimag)

    def _catalogues(
        self, rays: F8, central: NDArray[np.intp], catalogues: tuple[Patterns, ...], history: History | None
    ) -> tuple[list[int], int | None]:
        """Return the catalogues to probe, and the consensus one if there is any."""
        config = self.config
        if config.fixed_limit_decimag is not None:
            return [self._index(config.fixed_limit_decimag)], None
        consensus = None
        if history is not None:
            agreed = history.consensus(config.consensus_min_matches, config.consensus_min_similarity)
            if agreed is not None and agreed[0] in config.patterns.limits_decimag:
                consensus = self._index(agreed[0])
                if agreed[1] > config.consensus_fast_share:
                    return [consensus], consensus
        references = rays[central[: config.density_references]]
        radius = np.radians(config.patterns.radius_deg)
        density = float(np.median(np.count_nonzero(references @ rays.T >= np.cos(radius), axis=1) - 1))
        expected = np.array([catalogue.mean_neighbours for catalogue in catalogues])
        near = int(np.argmin(np.abs(np.log(np.maximum(expected, 1e-3)) - np.log(max(density, 0.5)))))
        choices = set(range(max(0, near - config.probe_steps), min(len(catalogues), near + config.probe_steps + 1)))
        if consensus is not None:
            choices.add(consensus)
        return sorted(choices), consensus

    def _search(
        self,
        rays: F8,
        central: NDArray[np.intp],
        catalogues: tuple[Patterns, ...],
        choices: list[int],
        consensus: int | None,
    ) -> _Hypothesis | None:
        """Try reference stars from the middle outwards until one is similar enough; else return the best."""
        config = self.config
        limit = 1 if not config.iterate else (config.max_references or len(central))
        best: _Hypothesis | None = None
        for reference in central[:limit]:
            view = self._view(rays, int(reference))
            if len(view.neighbour) < config.min_features:
                continue
            found = self._best_of_catalogues(view, catalogues, choices, consensus)
            if found is None:
                continue
            if found.similarity >= config.similarity_threshold and self._confirmed(found, catalogues):
                return found
            if best is None or (found.n_matches, found.similarity) > (best.n_matches, best.similarity):
                best = found
        return best

    def _view(self, rays: F8, reference: int) -> _View:
        theta = separations(rays[reference], rays)
        within = np.flatnonzero(theta <= np.radians(self.config.patterns.radius_deg))
        within = within[within != reference]
        within = within[np.argsort(theta[within], kind="stable")]
        return _View(reference, within, theta[within], bearings(rays[reference], rays[within]))

    def _best_of_catalogues(
        self, view: _View, catalogues: tuple[Patterns, ...], choices: list[int], consensus: int | None
    ) -> _Hypothesis | None:
        """Probe the catalogues: the highest similarity wins, unless the consensus comes close."""
        votes = [self._votes(view, catalogues[choice]) for choice in choices]
        similarity = np.array([vote.max(initial=0) for vote in votes]) / len(view.neighbour)
        best = int(np.argmax(similarity))
        if consensus in choices:
            preferred = choices.index(consensus)
            if similarity[preferred] >= similarity[best] - self.config.consensus_margin:
                best = preferred
        return self._best_star(view, choices[best], catalogues[choices[best]], votes[best])

    def _votes(self, view: _View, catalogue: Patterns) -> NDArray[np.int64]:
        """Votes of the image's features for each star of a catalogue; a feature gives a star one vote at most."""
        config = self.config
        patterns = config.patterns
        rho = view.theta_rad / max(float(view.theta_rad[-1]), 1e-12)
        if config.tolerance_bins == 0:
            return catalogue.votes(patterns.bins(view.theta_rad, rho))
        total = np.zeros(len(catalogue), dtype=np.int64)
        steps = range(-config.tolerance_bins, config.tolerance_bins + 1)
        # Seen star by star: which features have it in any of the bins around theirs.
        for theta, ratio in zip(view.theta_rad, rho, strict=True):
            around = [
                (theta + np.radians(s * patterns.theta_bin_deg), ratio + t * patterns.rho_bin)
                for s in steps
                for t in steps
            ]
            valid = [(a, b) for a, b in around if a >= 0 and 0 <= b < 1 + patterns.rho_bin]
            a, b = np.array(valid).T
            total += catalogue.votes(np.unique(patterns.bins(a, b))) > 0
        return total

    def _best_star(self, view: _View, choice: int, catalogue: Patterns, votes: NDArray[np.int64]) -> _Hypothesis | None:
        """Confirm the stars with most votes by bearings; the one with most agreeing neighbours wins."""
        config = self.config
        affordable = max(1, min(config.candidates, config.effort // len(view.neighbour)))
        order = np.argsort(-votes, kind="stable")[: affordable if config.confirm_by_bearing else 1]
        found: list[_Hypothesis] = []
        for star in order:
            alignment = self._align(view, catalogue, int(star)) if config.confirm_by_bearing else None
            similarity = float(votes[star]) / len(view.neighbour)
            found.append(_Hypothesis(view, choice, int(star), similarity, alignment, 0))
        if not found:
            return None
        found.sort(key=lambda hypothesis: (-hypothesis.n_matches, -hypothesis.similarity))
        best = found[0]
        # A polar star makes way for another reference star, not for the next candidate.
        declination_deg = abs(float(np.degrees(catalogue.dec_rad[best.star])))
        if config.reject_polar_deg is not None and declination_deg > config.reject_polar_deg:
            return None
        rivals = [h.n_matches for h in found[1:] if not self._same_place(catalogue, best.star, h.star)]
        return _Hypothesis(view, choice, best.star, best.similarity, best.alignment, max(rivals, default=0))

    def _same_place(self, catalogue: Patterns, star: int, other: int) -> bool:
        """Whether two stars are closer than the match tolerance: components of a double."""
        rows = slice(catalogue.start[star], catalogue.start[star + 1])
        close = catalogue.neighbour[rows][catalogue.theta_rad[rows] <= np.radians(self.config.match_tolerance_deg)]
        return bool((close == other).any())

    def _align(self, view: _View, catalogue: Patterns, star: int) -> Alignment:
        rows = slice(catalogue.start[star], catalogue.start[star + 1])
        return align(
            view.theta_rad,
            view.bearing_rad,
            catalogue.theta_rad[rows].astype(np.float64),
            catalogue.bearing_rad[rows].astype(np.float64),
            float(np.radians(self.config.match_tolerance_deg)),
            float(np.radians(self.config.patterns.radius_deg)),
        )

    def _confirmed(self, found: _Hypothesis, catalogues: tuple[Patterns, ...]) -> bool:
        if not self.config.confirm_by_bearing:
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
        if best.similarity < config.similarity_threshold or not self._confirmed(best, catalogues):
            return Identification(
                Reason.NO_HYPOTHESIS,
                f"no reference star is identified: at best {best.n_matches} of {len(best.view.neighbour)} neighbours "
                f"agree, similarity {best.similarity:.2f}",
                confidence=best.similarity,
                details=details,
            )
        if config.confirm_by_bearing and best.rival_matches > 0.8 * best.n_matches:
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


THESIS_BASELINE = DdrConfig(fixed_limit_decimag=40, iterate=False, reject_polar_deg=None)
THESIS_ADAPTIVE = DdrConfig()
