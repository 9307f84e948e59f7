"""Configuration of the thesis' matcher, and the configurations of section 5 of the thesis.

docs/thesis.md lists what the thesis leaves open, and the configuration field that decides each point.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from celnav.checking import bounded, check_fields
from celnav.errors import ConfigError
from celnav.matching.patterns import PatternConfig


@dataclass(frozen=True)
class DdrConfig:
    """Configuration of the DDR matcher. Frozen and hashable.

    Attributes
    ----------
    patterns : PatternConfig
        Catalogues, neighbour radius, theta_max and bins.
    fixed_limit_decimag : int or None
        Magnitude limit of the only catalogue to use (the thesis' baseline: 40); None selects among all.
    probe_steps : int
        Number of catalogues probed on either side of the one chosen by density.
    density_statistic : str
        ``median`` or ``mean`` of the neighbour counts.
    density_references : int or None
        Number of most central detections over which the density is taken; None: all.
    iterate : bool
        Similarity iteration: continue with further reference stars while the similarity is below `similarity_threshold`.
    similarity_threshold : float
        tau_c of the thesis.
    below_threshold : str
        Treatment of the best reference star if none reaches the threshold: ``refuse`` or ``accept``.
    reference_order : str
        Order of reference stars: ``centrality`` or ``brightness`` (centrality if fluxes are unknown).
    max_references : int or None
        Largest number of reference stars that the iteration tries; None: all detections.
    reject_polar_deg : float or None
        A reference star nearer to a pole than this |declination| is not accepted; None accepts all.
    polar_criterion : str
        Criterion of this rejection. ``declination``: |dec|. ``determinant``: |det J| = |cos dec cos H| / cos lat, which needs
        the attitude; the limit is then the cosine of `reject_polar_deg` (its value for a star of that declination on the
        meridian of an observer at the equator).
    vote_normalisation : str
        Votes are divided by the number of features of the ``image``, of the ``pattern``, or of the ``larger``.
    tolerance_bins : int
        A feature votes for its own bin and for this many on either side in theta and rho.
    candidates : int
        Number of stars with most votes that are confirmed by bearings; 1 confirms only the winner of the vote.
    effort : int
        Largest product of neighbours and candidates that are confirmed for a reference star. Among thousands of detections,
        fewer candidates are examined instead of taking more time.
    bearings : str
        How candidates are confirmed by relative bearings: one ``rotation`` for all neighbours, ``sorted-differences``
        from each neighbour to the next, or ``ignored``: the votes decide alone, and the reference star is the only
        match.
    match_tolerance_deg : float
        Distance within which a neighbour in the image and one in the pattern coincide.
    max_log10_false_alarm : float
        A candidate is confirmed if the probability that chance does as well is at most this (decimal logarithm, counting
        all stars of the catalogue and all rotations).
    min_matches : int
        Least number of neighbours that must agree.
    min_features : int
        Least number of neighbours of a reference star.
    brightest : bool
        If fluxes are known, keep only the brightest detections, as many as the deepest catalogue has stars in the camera's
        solid angle on average over the sky.
    brightest_factor : float
        Factor on that number.
    brightest_count : int or None
        Number of detections to keep instead.
    consensus_min_matches : int
        Least number of good matches in the history for a consensus.
    consensus_min_similarity : float
        Least similarity of a good match.
    consensus_margin : float
        The consensus catalogue overrides the best one if its similarity is at most this much lower.
    consensus_fast_share : float
        If its share of the good matches is above this, the consensus catalogue is used without probing.
    stars_in_fix : str
        ``all``: all confirmed matches (equation 3.10); ``one``: the reference star alone (section 4.v).
    """

    patterns: PatternConfig = field(default_factory=PatternConfig)
    fixed_limit_decimag: int | None = None
    probe_steps: int = bounded(1, 0, 1000)
    density_statistic: Literal["median", "mean"] = "median"
    density_references: int | None = bounded(5, 1)
    iterate: bool = True
    similarity_threshold: float = 0.45
    below_threshold: Literal["refuse", "accept"] = "refuse"
    reference_order: Literal["centrality", "brightness"] = "centrality"
    max_references: int | None = bounded(30, 1)
    reject_polar_deg: float | None = 75.0
    polar_criterion: Literal["declination", "determinant"] = "declination"
    vote_normalisation: Literal["image", "pattern", "larger"] = "image"
    tolerance_bins: int = bounded(0, 0, 100)
    candidates: int = bounded(30, 1, 10_000)
    effort: int = bounded(6000, 1, 10_000_000)
    bearings: Literal["rotation", "sorted-differences", "ignored"] = "rotation"
    match_tolerance_deg: float = bounded(0.5, 0, 180)
    max_log10_false_alarm: float = -4.0
    min_matches: int = bounded(3, 1)
    min_features: int = bounded(4, 2)
    brightest: bool = True
    brightest_factor: float = bounded(1.0, 0)
    brightest_count: int | None = bounded(None, 3)
    consensus_min_matches: int = 5
    consensus_min_similarity: float = 0.6
    consensus_margin: float = 0.05
    consensus_fast_share: float = 0.8
    stars_in_fix: Literal["all", "one"] = "all"

    def __post_init__(self) -> None:
        check_fields(self)
        if self.fixed_limit_decimag is not None and self.fixed_limit_decimag not in self.patterns.limits_decimag:
            raise ConfigError(f"fixed_limit_decimag = {self.fixed_limit_decimag} is none of the catalogues' limits")


# The configurations of the thesis, section 5, with our readings of what it leaves open.
THESIS_BASELINE = DdrConfig(fixed_limit_decimag=40, iterate=False, reject_polar_deg=None)
THESIS_BASELINE_SI = replace(THESIS_BASELINE, iterate=True)
THESIS_BASELINE_SI_PR = replace(THESIS_BASELINE_SI, reject_polar_deg=75.0)
THESIS_ADAPTIVE = DdrConfig()
# An ablation that Table 1.1 lacks: the catalogue is selected, and nothing else is added to the baseline.
THESIS_CATALOGUE_ONLY = DdrConfig(iterate=False, reject_polar_deg=None)

# The literal reading: votes alone decide and always claim a match, brightness is not used, one star gives the fix, and the
# neighbourhood is half the width of the field of view.
LITERAL_ADAPTIVE = DdrConfig(
    patterns=PatternConfig(radius_deg=60.0),
    density_statistic="mean",
    density_references=None,
    below_threshold="accept",
    bearings="ignored",
    brightest=False,
    stars_in_fix="one",
)
LITERAL_BASELINE = replace(LITERAL_ADAPTIVE, fixed_limit_decimag=40, iterate=False, reject_polar_deg=None)
LITERAL_BASELINE_SI = replace(LITERAL_BASELINE, iterate=True)
LITERAL_BASELINE_SI_PR = replace(LITERAL_BASELINE_SI, reject_polar_deg=75.0)
LITERAL_CATALOGUE_ONLY = replace(LITERAL_ADAPTIVE, iterate=False, reject_polar_deg=None)
