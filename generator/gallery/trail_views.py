"""Exposures of an hour: star trails."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.scenario.file import Scenario, load_scenario
from generator.scenario.shipped import find_scenario

SIZE_PX = 720, 480
VIEWS = (
    ("Around the pole, one hour", {"azimuth_deg": 0, "altitude_deg": 42, "roll_deg": 0}, "2020-09-15T20:30:00Z"),
    ("The east, one hour: Mars rises", {"azimuth_deg": 90, "altitude_deg": 24, "roll_deg": 0}, "2020-09-15T20:30:00Z"),
)
"""Title, attitude and start of each view."""
SKY, BLACK, WHITE, GAMMA = 0.7, 0.3, 10.0, 2.2
"""Quantile of the pixels that is the sky, multiples of it that are shown as black and white, exponent of the curve."""


def star_trails() -> Figure:
    """Two exposures of an hour over a wood, in colour: a figure."""
    figure = Figure(figsize=(13, 4.9), facecolor="#1f1f1f")
    scene = load_scenario(find_scenario("landscape"))
    for axis, (title, attitude, utc_start) in zip(figure.subplots(1, len(VIEWS)), VIEWS, strict=True):
        axis.imshow(_in_colour(_exposed(scene, attitude, utc_start)), interpolation="lanczos")
        axis.set_title(title, color="white", fontsize=10)
        axis.axis("off")
    return figure


def _exposed(scene: Scenario, attitude: dict[str, int], utc_start: str) -> Scenario:
    """Return a scene with another attitude and an exposure of an hour on a small sensor with a Bayer array."""
    template = copy.deepcopy(scene.template)
    template["camera"] |= {"width": SIZE_PX[0], "height": SIZE_PX[1]}
    template["sensor"] = template.get("sensor", {}) | {"colour": {"pattern": "RGGB"}}
    template["time"] |= {"utc_start": utc_start, "exposure_s": 3600.0}
    template["attitude"] = attitude
    template["foreground"] = {"landscape": {"skyline": ["forest"]}}
    template["stars"] = {"limiting_magnitude": 6.5}
    template["sky"] = {"bortle": 2}
    return dataclasses.replace(scene, template=template)


def _in_colour(scenario: Scenario) -> NDArray[np.uint8]:
    """Expected electrons of red, green and blue as a picture."""
    channels = render_expected(plan_frame(scenario, 0)).channels
    rgb = np.stack([channels[name] / np.quantile(channels[name], SKY) for name in ("red", "green", "blue")], axis=-1)
    shown = np.clip((rgb - BLACK) / (WHITE - BLACK), 0, 1) ** (1 / GAMMA)
    return np.rint(255 * shown).astype(np.uint8)
