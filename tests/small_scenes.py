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
    [470, 0], [480, 0.0331], [490, 0.1763], [500, 0.4855], [510, 0.8106], [520, 0.9856], [530, 1.000], [540, 0.9550],
    [550, 0.8653], [560, 0.7496], [570, 0.6360], [580, 0.5245], [590, 0.4141], [600, 0.3171], [610, 0.2346],
    [620, 0.1684], [630, 0.1136], [640, 0.0671], [650, 0.0367], [660, 0.0201], [670, 0.0134], [680, 0.0101],
    [690, 0.0069], [700, 0],
]  # fmt: skip
"""Bessell 1990 V, divided by the wavelength, as a quantum efficiency: a camera that measures V directly."""


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
