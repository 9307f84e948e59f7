"""A meteor camera's stack of video frames."""

from __future__ import annotations

import io

import numpy as np
from astropy.io import fits
from matplotlib.figure import Figure

from generator.frame.render import render_frame
from generator.frame.video.take import STACK_SUFFIX
from generator.scenario.file import load_scenario
from generator.scenario.shipped import find_scenario

TITLES = {
    "MAXPIXEL": "Maximum of 256 frames",
    "AVEPIXEL": "Mean",
    "MAXFRAME": "Frame of the maximum, 0 to 255",
    "STDPIXEL": "Standard deviation as stored",
}
LARGEST = {"MAXPIXEL": 120, "AVEPIXEL": 80, "MAXFRAME": 255, "STDPIXEL": 12}
"""Value that is shown as white."""


def meteor_stack() -> Figure:
    """The four pictures of the shipped scene `meteor`: a figure."""
    frame = render_frame(load_scenario(find_scenario("meteor")), 0)
    figure = Figure(figsize=(13, 8.0), facecolor="#1f1f1f")
    with fits.open(io.BytesIO(frame.attached[STACK_SUFFIX])) as stored:
        for axis, (name, title) in zip(figure.subplots(2, 2).flat, TITLES.items(), strict=True):
            axis.imshow(np.array(stored[name].data), cmap="gray", vmin=0, vmax=LARGEST[name])
            axis.set_title(title, color="white", fontsize=10)
            axis.axis("off")
    return figure
