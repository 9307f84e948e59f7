"""Skylines by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from generator.ground.panorama import Panorama
from generator.ground.skylines.buildings import draw_roofs, draw_street
from generator.ground.skylines.canvas import Canvas
from generator.ground.skylines.forest import draw_forest
from generator.ground.skylines.hills import draw_hills
from generator.ground.skylines.masts import draw_masts

SKYLINES: dict[str, Callable[[Canvas], None]] = {
    "hills": draw_hills,
    "forest": draw_forest,
    "roofs": draw_roofs,
    "masts": draw_masts,
    "street": draw_street,
}


def skyline_panorama(names: Sequence[str], rng: np.random.Generator, glow_cd_m2: float) -> Panorama:
    """Panorama of skylines, drawn in the order of their names, each over those before it."""
    canvas = Canvas(rng)
    draw_skylines(canvas, names)
    return canvas.panorama(glow_cd_m2)


def draw_skylines(canvas: Canvas, names: Sequence[str]) -> None:
    """Draw skylines in the order of their names, each over the existing content."""
    for name in names:
        SKYLINES[name](canvas)
