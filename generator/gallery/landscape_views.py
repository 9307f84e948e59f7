"""Landscapes in front of the sky, as a colour camera develops them."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from generator.frame.render import render_frame
from generator.scenario.file import Scenario, load_scenario
from generator.scenario.shipped import find_scenario

SIZE_PX = 720, 480
VIEWS: tuple[tuple[str, list[str], float, str], ...] = (
    ("landscape", [], 10.0, "Trees, houses, a mast and a lamp by seed"),
    ("hills", [], 10.0, "Hills of an elevation raster, the air before them, a mast"),
    ("landscape", ["street"], 0.05, "A street with lamps and lit windows, 1/20 s"),
    ("hills", ["forest"], 10.0, "The same hills behind a wood"),
)
"""Scene, skyline (by default the scene's), exposure, title."""


def landscapes() -> Figure:
    """Shipped scenes with landscapes in colour: a figure."""
    figure = Figure(figsize=(13, 9.6), facecolor="#1f1f1f")
    for axis, (name, skyline, exposure_s, title) in zip(figure.subplots(2, 2).flat, VIEWS, strict=True):
        axis.imshow(
            _developed(_in_colour(load_scenario(find_scenario(name)), skyline, exposure_s)), interpolation="lanczos"
        )
        axis.set_title(title, color="white", fontsize=10)
        axis.axis("off")
    return figure


def _in_colour(scenario: Scenario, skyline: list[str], exposure_s: float) -> Scenario:
    """Return a scenario with a smaller sensor with a Bayer array, and with another skyline if one is given."""
    template = copy.deepcopy(scenario.template)
    template["camera"] |= {"width": SIZE_PX[0], "height": SIZE_PX[1]}
    template["sensor"] = template.get("sensor", {}) | {"colour": {"pattern": "RGGB"}, "develop": {"exposure": "auto"}}
    template["time"]["exposure_s"] = exposure_s
    if skyline:
        template["foreground"]["landscape"]["skyline"] = skyline
    return dataclasses.replace(scenario, template=template)


def _developed(scenario: Scenario) -> NDArray[np.uint8]:
    picture = render_frame(scenario, 0).developed
    assert picture is not None
    return picture
