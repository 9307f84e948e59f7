"""A wood: single trees around the camera, conifers and broadleaved ones, whose crowns have gaps.

Trees are 8 to 25 m high; the crowns of conifers are a third, those of broadleaved trees two thirds as wide as the tree is
high, as for open-grown trees (Hasenauer 1997, Forest Ecology and Management 96, 197). The gaps are skybench's own choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.ground.panorama import EYE_HEIGHT_M
from generator.ground.skylines.canvas import Canvas, Patch, smooth_noise, strip

Floats = NDArray[np.float64]

TREES = 180
NEAREST_M, FARTHEST_M = 14.0, 90.0
LEAVES = np.array([[0.035, 0.060, 0.020], [0.050, 0.075, 0.022], [0.025, 0.045, 0.020]])
"""Linear reflectances of leaves in crowns, red, green, blue."""
BARK = np.array([0.06, 0.048, 0.038])
BLOBS = 14
OUTSIDE = -1.5
"""Density above which there may be leaves."""


def draw_forest(canvas: Canvas) -> None:
    """Draw a wood around the camera with a clearing, from far to near."""
    rng = canvas.rng
    distance = np.sort(NEAREST_M * (FARTHEST_M / NEAREST_M) ** rng.random(TREES))[::-1]
    azimuth = rng.uniform(0, 360, TREES)
    # For the clearing, trees on one side are farther away.
    opening = rng.uniform(0, 360)
    distance = np.where(np.abs((azimuth - opening + 180) % 360 - 180) < 35, np.maximum(distance, 60.0), distance)
    order = np.argsort(-distance, kind="stable")
    for tree in order:
        height = rng.uniform(8, 25)
        conifer = rng.random() < 0.5
        width = height * (rng.uniform(0.25, 0.4) if conifer else rng.uniform(0.5, 0.75))
        away = float(distance[tree])
        low, high = (np.degrees(np.arctan2(level, away)) for level in (-EYE_HEIGHT_M, height - EYE_HEIGHT_M))
        patch = canvas.patch(
            float(azimuth[tree]), float(np.degrees(np.arctan2(0.6 * width, away))), float(low), float(high)
        )
        x, y = (part.reshape(shape) for part, shape in zip(patch.metres(away), ((1, -1), (-1, 1)), strict=True))
        step = away * np.radians(canvas.step_deg)
        crown = conifer_crown if conifer else broad_crown
        density = crown(rng, x, y, height, width)
        alpha = leaves(rng, patch, density, step)
        trunk = strip(x, 0.0, 0.03 * height, step) * ((y > 0) & (y < 0.8 * height))
        colour = LEAVES[rng.integers(len(LEAVES))] * (1 + 0.3 * smooth_noise(rng, patch.shape, 1.5))[..., None]
        canvas.draw(patch, trunk, BARK, away)
        canvas.draw(patch, alpha, np.maximum(colour, 0.005), away)


def conifer_crown(rng: np.random.Generator, x: Floats, y: Floats, height: float, width: float) -> Floats:
    """Density of a cone with whorls of branches: 1 inside, falling to 0 at the tips and below 0 outside."""
    foot = 0.12 * height
    up = np.clip((y - foot) / (height - foot), 0, 1)
    whorls = 0.78 + 0.22 * np.abs(((up * height / 0.7 + rng.random()) % 1.0) * 2 - 1)
    radius = np.maximum(0.5 * width * (1 - up) * whorls, 0.03)
    inside = (y > foot) & (y < height)
    return np.where(inside, 2.2 * (1 - np.abs(x) / radius), -3.0)


def broad_crown(rng: np.random.Generator, x: Floats, y: Floats, height: float, width: float) -> Floats:
    """Density of a crown of round clumps of leaves."""
    density = np.full(np.broadcast_shapes(x.shape, y.shape), -3.0)
    foot = 0.25 * height
    for _ in range(BLOBS):
        turn, far = rng.uniform(0, 2 * np.pi), np.sqrt(rng.random())
        middle = (0.33 * width * far * np.cos(turn), foot + 0.5 * (height - foot) * (1 + 0.62 * far * np.sin(turn)))
        size = rng.uniform(0.12, 0.22) * width
        # Only places that may exceed OUTSIDE are examined.
        reach = (1 - 0.5 * OUTSIDE) * size
        near = np.ix_(np.abs(y.ravel() - middle[1]) < reach, np.abs(x.ravel() - middle[0]) < reach)
        clump = 2.0 * (1 - np.hypot(x[:, near[1][0]] - middle[0], y[near[0][:, 0]] - middle[1]) / size)
        density[near] = np.maximum(density[near], clump)
    return density


def leaves(rng: np.random.Generator, patch: Patch, density: Floats, step_m: float) -> Floats:
    """Alpha of leaves: a threshold, which follows the crown, on noise of the sizes of twigs (0.3 m) and leaves (0.06 m)."""
    noise = 0.7 * smooth_noise(rng, patch.shape, max(0.3 / step_m, 0.7))
    noise = noise + 0.7 * smooth_noise(rng, patch.shape, max(0.06 / step_m, 0.5))
    return np.clip(0.5 + 0.9 * (density + 0.35 + noise), 0, 1) * (density > OUTSIDE)
