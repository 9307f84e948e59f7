"""Drawing a round's frames: for each a scenario, the precision of the supplied data, and a name that reveals nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmark.errors import RoundError
from benchmark.instruments import Precision
from benchmark.rounds.rules import INSTRUMENTS, Rules
from benchmark.rounds.secret import RoundKey
from generator.errors import ScenarioError
from generator.reading.strict_yaml import strict_text
from generator.scenario.file import Scenario, parse_scenario
from generator.scenario.variation import Draw

PURPOSES = {"site": "site", "time": "time", "attitude": "pose", "motion": "pose", "camera": "camera"}
"""Random stream for each section of a scenario; the sections not listed here are nuisances."""
NUISANCE = "nuisance"
NAME_DIGITS = 16
MOST_FRAMES = 20_000


@dataclass(frozen=True)
class DrawnFrame:
    """One frame of a round, before it is rendered.

    Attributes
    ----------
    index : int
        Position in the order of drawing, which is not published with the frames.
    name : str
        Name that solvers see: a keyed hash of the index.
    kind : str
        One of the kinds of the rules.
    scenario_text : str
        YAML of one frame, with every value fixed.
    precision : Precision
    """

    index: int
    name: str
    kind: str
    scenario_text: str
    precision: Precision

    @property
    def scenario(self) -> Scenario:
        """The parsed scenario."""
        return parse_scenario(self.scenario_text, f"round frame {self.index}")


def draw_frames(rules: Rules, key: RoundKey, count: int) -> tuple[DrawnFrame, ...]:
    """Draw the frames of a round, in the order of drawing; a larger number begins with the same frames.

    Every frame has its own place, time and pose, and one level of each graded quantity: no two frames share a sky.

    Raises
    ------
    RoundError
        The rules allow an impossible value.
    """
    if not 1 <= count <= MOST_FRAMES:
        raise RoundError(f"{count} frames; a round has 1 to {MOST_FRAMES}")
    try:
        frames = tuple(_draw_frame(rules, key, index) for index in range(count))
    except ScenarioError as error:
        raise RoundError(f"rules {rules.file.name}: {error}") from error
    if len({frame.name for frame in frames}) < count:
        raise RoundError("two frames have the same name, which happens once in 10^15 rounds; draw with another secret")
    return frames


def _draw_frame(rules: Rules, key: RoundKey, index: int) -> DrawnFrame:
    shares = np.array([kind.share for kind in rules.file.kinds], dtype=np.float64)
    kind = rules.file.kinds[int(key.stream("kind", index).choice(len(shares), p=shares / shares.sum()))].name
    template = rules.templates[kind]

    def stream_of(draw: Draw) -> np.random.Generator:
        return key.stream(f"{PURPOSES.get(draw.path[0], NUISANCE)}:{'.'.join(draw.path)}", index)

    seed = int.from_bytes(key.digest("noise", index)[:8], "big") >> 1  # records store signed 64-bit integers
    head: dict[str, Any] = {"name": f"{rules.file.name}-{index:05d}", "seed": seed}
    text = strict_text(head | template.drawn(0, stream_of), sort_keys=False)
    return DrawnFrame(
        index, f"f{key.digest('name', index).hex()[:NAME_DIGITS]}", kind, text, _precision(rules, key, index)
    )


def _precision(rules: Rules, key: RoundKey, index: int) -> Precision:
    values = {}
    for name in INSTRUMENTS:
        drawn = rules.instrument_draws[name]
        stream = key.stream(f"precision:{name}", index)
        values[name] = float(drawn.distribution.draw(stream, None) if isinstance(drawn, Draw) else drawn)
    return Precision(**values)
