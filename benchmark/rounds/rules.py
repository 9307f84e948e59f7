"""The rules of a round: published ranges of cameras, skies, nuisances and instruments, in a strict YAML file.

Every value may be a distribution in the language of scenarios (docs/scenarios.md). `common` applies to all frames, and each
of the `kinds` adds or replaces values; `instruments` state how precisely solvers receive time, attitude, camera and air.
"""

from __future__ import annotations

import copy
import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, ValidationError

from benchmark.errors import RoundError
from benchmark.wrong_key import wrong_key
from generator.errors import ScenarioError
from generator.files import read_text_at_most
from generator.reading.strict_yaml import StrictLoader, strict_text
from generator.scenario.file import Scenario, parse_scenario
from generator.scenario.strict import Strict
from generator.scenario.variation import Draw, find_variations

FOLDER = Path(__file__).parent
SUFFIX = ".rules.yaml"
LARGEST_FILE_BYTES = 100_000
MOST_KINDS = 50
INSTRUMENTS = {
    "tilt_sigma_deg": (1e-4, 30.0),
    "heading_sigma_deg": (1e-4, 180.0),
    "utc_sigma_s": (1e-4, 60.0),
    "focal_sigma": (1e-5, 0.3),
    "principal_point_sigma_px": (1e-3, 100.0),
    "pressure_sigma_hpa": (0.01, 50.0),
    "temperature_sigma_c": (0.01, 20.0),
}
"""Standard deviations that every set of rules must state, with their limits: nothing is supplied exactly."""


class KindFile(Strict):
    """A camera and its use."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,39}$")]
    share: Annotated[int, Field(ge=1, le=1000)]
    """Share of the frames, relative to the shares of all kinds."""
    source: Annotated[str, Field(min_length=10, max_length=1000)]
    """Source of its ranges."""
    scenario: dict[str, Any]
    """Values of the scenario that replace or extend those of `common`."""


class RulesFile(Strict):
    """The content of the file."""

    format: Literal["skybench-round-rules/1"]
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,39}$")]
    title: Annotated[str, Field(min_length=10, max_length=120)]
    sources: dict[str, Annotated[str, Field(min_length=10, max_length=1000)]]
    """Sources of the ranges of `common` and `instruments`, by key."""
    instruments: dict[str, Any]
    common: dict[str, Any]
    kinds: Annotated[list[KindFile], Field(min_length=1, max_length=MOST_KINDS)]


@dataclass(frozen=True)
class Rules:
    """Rules that have been read and checked.

    Attributes
    ----------
    file : RulesFile
    text : str
        The text as published.
    """

    file: RulesFile
    text: str

    @property
    def sha256(self) -> str:
        """Hash of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @cached_property
    def templates(self) -> dict[str, Scenario]:
        """Scenario of each kind, with its distributions not yet drawn."""
        return {kind.name: _template(self.file, kind) for kind in self.file.kinds}

    @cached_property
    def instrument_draws(self) -> dict[str, Draw | float]:
        """Distribution or fixed value of each instrument."""
        _, draws = find_variations(self.file.instruments, f"{self.file.name}: instruments")
        varied: dict[str, Draw | float] = {draw.path[0]: draw for draw in draws}
        return {name: varied.get(name, given) for name, given in self.file.instruments.items()}


def load_rules(place: str | Path) -> Rules:
    """Read rules from a file, or by the name of rules that come with skybench.

    Raises
    ------
    RoundError
        There are no such rules, or they are invalid; the message names the key.
    """
    path = FOLDER / f"{place}{SUFFIX}" if str(place) in rules_names() else Path(place)
    try:
        return parse_rules(read_text_at_most(path, LARGEST_FILE_BYTES), str(path))
    except (OSError, UnicodeDecodeError) as error:
        known = ", ".join(rules_names())
        raise RoundError(
            f"{path}: the rules cannot be read ({error}); those that come with skybench: {known}"
        ) from error


def rules_names() -> tuple[str, ...]:
    """Names of the rules that come with skybench."""
    return tuple(sorted(path.name.removesuffix(SUFFIX) for path in FOLDER.glob(f"*{SUFFIX}")))


def parse_rules(text: str, source: str) -> Rules:
    """Check the text of rules; `source` is its name in messages. Raises RoundError."""
    try:
        tree = yaml.load(text, Loader=StrictLoader)  # a SafeLoader underneath
        file = RulesFile.model_validate(tree)
    except ValidationError as error:
        raise RoundError(f"{source}: {wrong_key(error, RulesFile)}") from error
    except RecursionError as error:
        raise RoundError(f"{source}: not valid YAML (nested too deep)") from error
    # An integer of thousands of digits raises a ValueError.
    except (ValueError, yaml.YAMLError) as error:
        raise RoundError(f"{source}: not valid YAML ({' '.join(str(error).split())})") from error
    rules = Rules(file, text)
    names = [kind.name for kind in file.kinds]
    if len(set(names)) != len(names):
        raise RoundError(f"{source}: kinds: give each name once, found {', '.join(names)}")
    try:
        _check_instruments(rules, source)
        for name, template in rules.templates.items():
            _check_template(template, f"{source}: kind {name}")
    except ScenarioError as error:
        raise RoundError(f"{source}: {error}") from error
    return rules


def _template(file: RulesFile, kind: KindFile) -> Scenario:
    tree = {"name": f"{file.name}-{kind.name}"[:64]} | _merged(file.common, kind.scenario)
    return parse_scenario(strict_text(tree, sort_keys=False), f"kind {kind.name}")


def _merged(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Merge a kind's values into the common ones; mappings that are no distributions are merged key by key."""
    result = copy.deepcopy(common)
    for key, value in own.items():
        there = result.get(key)
        if isinstance(value, dict) and isinstance(there, dict) and not _varies(value) and not _varies(there):
            result[key] = _merged(there, value)
        else:
            result[key] = copy.deepcopy(value)
    return result


def _varies(tree: dict[str, Any]) -> bool:
    sweeps, draws = find_variations(tree, "rules")
    return () in [sweep.path for sweep in sweeps] + [draw.path for draw in draws]


def _check_instruments(rules: Rules, source: str) -> None:
    given = rules.file.instruments
    if set(given) != set(INSTRUMENTS):
        wrong = sorted(set(given) ^ set(INSTRUMENTS))
        raise RoundError(f"{source}: instruments.{wrong[0]}: give {', '.join(INSTRUMENTS)}, each once and nothing else")
    for name, (low, high) in INSTRUMENTS.items():
        drawn = rules.instrument_draws[name]
        for value in drawn.distribution.typical() if isinstance(drawn, Draw) else [drawn]:
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not low <= value <= high:
                raise RoundError(f"{source}: instruments.{name}: found {value!r}, expected {low:g} to {high:g}")


def _check_template(template: Scenario, where: str) -> None:
    if template.axes or template.steps is not None or template.repeats != 1:
        raise RoundError(f"{where}: draws single frames; leave out sweeps, sequences and frames")
    if template.files:
        raise RoundError(
            f"{where}: names the file {template.files[0].path}; a round's rules are one file, leave it out"
        )
    if template.seed:
        raise RoundError(f"{where}: seed: comes from the round's secret; leave it out")
    if "drift" in template.template:
        raise RoundError(f"{where}: drift: what solvers are told comes from instruments; leave it out")
    varied = {draw.path for draw in template.draws}
    needed = [("site", "latitude_deg"), ("site", "longitude_deg"), ("time", "utc_start")]
    if missing := [".".join(path) for path in needed if path not in varied]:
        raise RoundError(f"{where}: {missing[0]}: must be drawn, so that no frame's place or time is known")
