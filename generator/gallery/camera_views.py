"""Frames of commercially available cameras, each by its preset, as the camera records them."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from generator.frame.render import render_frame
from generator.scenario.file import load_scenario
from generator.scenario.shipped import find_shipped

SCENES = {
    "telephone": "Telephone, 2 s, houses of a suburb",
    "uav": "UAV, 0.5 s, turning and shaking",
    "star_tracker": "Star tracker, 1 s, 15.5° x 10.5°",
}
SIDE_PX = 1000
"""Approximate length of the longest side of a picture."""
LOW, HIGH, GAMMA = 0.3, 0.999, 1.6


def cameras() -> Figure:
    """A sheet of one frame of each camera of `SCENES`; greys from the sky to the brightest stars."""
    figure = Figure(figsize=(5.2 * len(SCENES), 4.6), facecolor="#1f1f1f")
    for axis, (name, title) in zip(figure.subplots(1, len(SCENES)), SCENES.items(), strict=True):
        frame = render_frame(load_scenario(find_shipped(name)), 0, channels=False)
        picture = frame.developed if frame.developed is not None else _grey(frame.dn)
        axis.imshow(_shown(picture), cmap="gray", interpolation="lanczos")
        axis.set_title(title, color="white", fontsize=10)
        axis.axis("off")
    return figure


def _grey(dn: NDArray[np.uint16]) -> NDArray[np.uint8]:
    low, high = np.quantile(dn, [LOW, HIGH])
    return np.rint(255 * np.clip((dn - low) / max(high - low, 1), 0, 1) ** (1 / GAMMA)).astype(np.uint8)


def _shown(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Reduce the picture to means over squares of pixels, about `SIDE_PX` wide."""
    step = max(round(max(picture.shape[:2]) / SIDE_PX), 1)
    height, width = (side // step * step for side in picture.shape[:2])
    parts = picture[:height, :width].reshape(height // step, step, width // step, step, *picture.shape[2:])
    return np.rint(parts.mean(axis=(1, 3))).astype(np.uint8)
