"""Small scenarios for tests: a base that renders in a moment, and overrides by key path."""

from __future__ import annotations

import copy
from typing import Any

import yaml

from generator.scenario.file import Scenario, parse_scenario

BASE: dict[str, Any] = {
    "name": "test",
    "seed": 7,
    "site": {"latitude_deg": 52.0, "longitude_deg": 4.36},
    "time": {"utc_start": "2020-01-15T20:00:00Z", "exposure_s": 0.5},
    # A lens without stray light, which tests of it add.
    "camera": {
        "width": 270,
        "height": 180,
        "hfov_deg": 120,
        "aperture_mm": 4,
        "bloom": {"share": 0},
        "veiling_glare": 0,
    },
    "sky": {"bortle": 4},
}
FISHEYE_CAMERA: dict[str, Any] = {
    "width": 400,
    "height": 400,
    "model": "equidistant",
    "f_px": 120.0,
    "aperture_mm": 4.0,
    "bloom": {"share": 0},
    "veiling_glare": 0,
}
V_BAND_QE = [
    [470, 0], [480, 0.030], [490, 0.163], [500, 0.458], [510, 0.780], [520, 0.967], [530, 1.000], [540, 0.973],
    [550, 0.898], [560, 0.792], [570, 0.684], [580, 0.574], [590, 0.461], [600, 0.359], [610, 0.270], [620, 0.197],
    [630, 0.135], [640, 0.081], [650, 0.045], [660, 0.025], [670, 0.017], [680, 0.013], [690, 0.009], [700, 0],
]  # fmt: skip
"""Bessell 1990 V as a quantum efficiency: a camera that measures V directly."""


def small_scenario(**overrides: Any) -> Scenario:
    """The base scenario with values replaced; keys are paths with ``__`` for the dots, None removes a key."""
    return parse_scenario(small_scenario_text(**overrides), "test.yaml")


def small_scenario_text(**overrides: Any) -> str:
    """The same as the text of a scenario file."""
    tree = copy.deepcopy(BASE)
    for path, value in overrides.items():
        *parents, last = path.split("__")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        if value is None:
            node.pop(last, None)
        else:
            node[last] = value
    return yaml.safe_dump(tree, sort_keys=False)
