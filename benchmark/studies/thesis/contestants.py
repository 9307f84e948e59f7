"""Contestants of the replication: the registered variants, and the literal reading of the thesis."""

from __future__ import annotations

from dataclasses import replace

import celnav
from benchmark.studies.common.contestants import Contestant
from celnav.matching import thesis_config as configs
from celnav.matching.patterns import PatternConfig
from celnav.solver import SOLVERS

BASELINE, ADAPTIVE = "thesis-baseline", "thesis-adaptive"
BASELINE_SI, BASELINE_SI_PR = "thesis-baseline+si", "thesis-baseline+si+pr"
CATALOGUE_ONLY, BRIGHTEST_N, DAI = "thesis-catalogue-only", "brightest-n", "ddr-dai"
ADAPTIVE_ONE_STAR = "thesis-adaptive, one star"
LITERAL = {
    "literal baseline": configs.LITERAL_BASELINE,
    "literal baseline+si": configs.LITERAL_BASELINE_SI,
    "literal baseline+si+pr": configs.LITERAL_BASELINE_SI_PR,
    "literal catalogue-only": configs.LITERAL_CATALOGUE_ONLY,
    "literal adaptive": configs.LITERAL_ADAPTIVE,
}
LITERAL_BASELINE, LITERAL_ADAPTIVE = "literal baseline", "literal adaptive"
# The rows of Table 1.1 in both readings; the fifth is the ablation that the thesis lacks.
OURS_IN_TABLE = (BASELINE, BASELINE_SI, BASELINE_SI_PR, ADAPTIVE, CATALOGUE_ONLY)
LITERAL_IN_TABLE = tuple(
    f"literal {name}" for name in ("baseline", "baseline+si", "baseline+si+pr", "adaptive", "catalogue-only")
)


def registered() -> list[Contestant]:
    """The seven variants that `celnav.solvers()` names."""
    names = (BASELINE, BASELINE_SI, BASELINE_SI_PR, CATALOGUE_ONLY, ADAPTIVE, DAI, BRIGHTEST_N)
    return [Contestant(name, SOLVERS[name]) for name in names]


def literal() -> list[Contestant]:
    """The thesis in its literal reading: see `celnav.matching.thesis_config`."""
    return [Contestant(name, celnav.ddr_solver(config)) for name, config in LITERAL.items()]


def one_star() -> Contestant:
    """`thesis-adaptive` with only the reference star in the fix."""
    return Contestant(ADAPTIVE_ONE_STAR, celnav.ddr_solver(replace(configs.THESIS_ADAPTIVE, stars_in_fix="one")))


def adaptive_of_radius(name: str, radius_deg: float) -> Contestant:
    """The literal adaptive variant with another neighbour radius."""
    patterns = PatternConfig(radius_deg=radius_deg)
    return Contestant(name, celnav.ddr_solver(replace(configs.LITERAL_ADAPTIVE, patterns=patterns)))
