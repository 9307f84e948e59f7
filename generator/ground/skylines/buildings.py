"""Houses around a yard, and a street between rows of houses with lamps; some of their windows are lit.

Street lamps: luminaires of 6,000 lm on poles of 8 m every 30 m. Their intensity by the angle from the nadir (350 cd/klm
at 70 deg, 100 at 80, 10 at 90 and zero above) is of the order of the limits of the stricter classes of EN 13201-2 (G*);
it has not been checked against the standard's text. The fraction of lit windows, a third, and their brightness are
skybench's own choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.ground.lamp import Lamp
from generator.ground.panorama import EYE_HEIGHT_M
from generator.ground.skylines.canvas import Canvas, covered, smooth_noise, strip

Floats = NDArray[np.float64]

WALLS = np.array([[0.35, 0.16, 0.11], [0.45, 0.42, 0.36], [0.30, 0.28, 0.25], [0.55, 0.52, 0.47]])
"""Brick, plaster, concrete, light paint: linear reflectances."""
ROOFS = np.array([[0.14, 0.06, 0.04], [0.06, 0.06, 0.07]])
ASPHALT = np.array([0.08, 0.08, 0.08])
LIT_SHARE = 0.33
WARM = np.array([1.0, 0.62, 0.28])
"""Colour of a lit window relative to white."""
STOREY_M, WINDOW_STEP_M = 3.1, 3.0
WINDOW = (1.0, 2.4, 1.3)
"""Window: lower and upper edge above the floor, and width, m."""
HALF_STREET_M, STREET_LENGTH_M = 9.0, 260.0
LAMP_HEIGHT_M, LAMP_SPACING_M, LAMP_KLM = 8.0, 30.0, 6.0
GAMMA_DEG = (0.0, 60.0, 70.0, 80.0, 90.0)
CD_PER_KLM = (160.0, 350.0, 350.0, 100.0, 10.0)


def lamp_intensity_cd(gamma_deg: float) -> float:
    """Intensity of a street lamp at an angle from the nadir; zero above the horizontal."""
    return LAMP_KLM * float(np.interp(gamma_deg, GAMMA_DEG, CD_PER_KLM)) if gamma_deg <= 90 else 0.0


def windows(
    rng: np.random.Generator, along: Floats, y: Floats, top: Floats | float
) -> tuple[NDArray[np.bool_], Floats]:
    """Which places on a front are glass, and the brightness of each (0 for dark, up to 1), by place along it and height."""
    column, storey = np.floor(along / WINDOW_STEP_M), np.floor(y / STOREY_M)
    x_in, y_in = along - (column + 0.5) * WINDOW_STEP_M, y - storey * STOREY_M
    glass = (np.abs(x_in) < WINDOW[2] / 2) & (y_in > WINDOW[0]) & (y_in < WINDOW[1]) & (y < top - 0.6) & (y > 0)
    table = rng.random((64, 4096)) < LIT_SHARE
    bright = rng.uniform(0.15, 1.0, (64, 4096))
    index = (np.clip(storey, 0, 63).astype(np.intp), column.astype(np.intp) % 4096)
    return glass, np.where(glass & table[index], bright[index], 0.0)


def draw_roofs(canvas: Canvas) -> None:
    """Draw houses around a yard: walls, pitched roofs, chimneys, lit windows."""
    rng = canvas.rng
    azimuth = rng.uniform(0, 360)
    end = azimuth + 350
    while azimuth < end:
        away, width = rng.uniform(22, 45), rng.uniform(8, 16)
        half = float(np.degrees(np.arctan2(width / 2, away)))
        _house(canvas, azimuth + half, away, width)
        azimuth += 2 * half + float(rng.choice([0.0, 0.0, rng.uniform(2, 12)]))


def _house(canvas: Canvas, azimuth: float, away: float, width: float) -> None:
    rng = canvas.rng
    eaves, rise = STOREY_M * rng.integers(1, 4), rng.uniform(2.5, 4.5)
    top = float(np.degrees(np.arctan2(eaves + rise + 2, away)))
    low = -float(np.degrees(np.arctan2(EYE_HEIGHT_M, away)))
    patch = canvas.patch(azimuth, float(np.degrees(np.arctan2(0.56 * width, away))), low, top)
    x, y = patch.metres(away)
    x, y = x[None, :], y[:, None]
    step = away * np.radians(canvas.step_deg)
    side = strip(x, 0.0, width, step)
    gable = rng.random() < 0.5
    slope = 1 - np.abs(x) / (width / 2) if gable else (width / 2 + 0.3 - np.abs(x)) / 1.2
    ridge = eaves + rise * np.clip(slope, 0, 1)
    roof = covered(ridge, y, step) * (y > eaves) * strip(x, 0.0, width + 0.6, step)
    chimney = strip(x, rng.uniform(-0.3, 0.3) * width, 0.7, step) * ((y > eaves) & (y < eaves + rise + 0.9))
    tiles = ROOFS[rng.integers(len(ROOFS))] * (1 + 0.15 * smooth_noise(rng, patch.shape, 0.8))[..., None]
    canvas.draw(patch, chimney, WALLS[0], away)
    canvas.draw(patch, roof, np.maximum(tiles, 0.01), away)
    whole = np.floor(width / WINDOW_STEP_M) * WINDOW_STEP_M
    glass, light = windows(rng, x + whole / 2 + np.zeros_like(y), y + np.zeros_like(x), eaves)
    glass = glass & (np.abs(x) < whole / 2)
    light = np.where(glass, light, 0.0)
    wall = WALLS[rng.integers(len(WALLS))] * (1 + 0.08 * smooth_noise(rng, patch.shape, 1.0))[..., None]
    front = side * ((y > 0) & (y <= eaves))
    canvas.draw(patch, front, np.where(glass[..., None], 0.04, wall), away, light[..., None] * WARM)


def draw_street(canvas: Canvas) -> None:
    """Draw a straight street between rows of houses, with the camera in its middle and lamps on both sides."""
    rng = canvas.rng
    heading = rng.uniform(0, 360)
    patch = canvas.whole(-90.0, 74.0)
    turn = np.radians(180.0 + patch.offset_deg - heading)
    sine = np.where(np.abs(np.sin(turn)) < 1e-4, 1e-4, np.sin(turn))
    along = np.clip(HALF_STREET_M * np.cos(turn) / np.abs(sine), -STREET_LENGTH_M, STREET_LENGTH_M)
    side = (sine > 0).astype(np.intp)
    end = np.abs(along) >= STREET_LENGTH_M
    away = np.where(end, STREET_LENGTH_M / np.maximum(np.abs(np.cos(turn)), 1e-4), HALF_STREET_M / np.abs(sine))
    across = np.where(end, away * np.sin(turn), along)
    y = away * np.tan(np.radians(np.clip(patch.altitude_deg, -89, 89)))[:, None] + EYE_HEIGHT_M
    plot = np.floor((along + 1000) / 11.0).astype(np.intp) % 512
    height = STOREY_M * rng.integers(2, 6, (2, 512))[side, plot] + rng.uniform(0, 1.5, (2, 512))[side, plot]
    kind = rng.integers(0, len(WALLS), (2, 512))[side, plot]
    step = away * np.radians(canvas.step_deg)
    front = covered(height, y, step) * (y > 0)
    glass, light = windows(rng, np.broadcast_to(across + 1000 + 3000 * side, y.shape), y, height)
    wall = WALLS[kind] * (1 + 0.06 * smooth_noise(rng, patch.shape, 1.0))[..., None]
    reach = away / np.maximum(np.cos(np.radians(patch.altitude_deg)), 0.02)[:, None]
    canvas.draw(patch, front, np.where(glass[..., None], 0.04, wall), reach, light[..., None] * WARM)
    floor = (y <= 0) & (patch.altitude_deg < 0)[:, None]
    depth = EYE_HEIGHT_M / np.sin(np.radians(np.maximum(-patch.altitude_deg, 1e-2)))
    canvas.draw(patch, floor.astype(float), ASPHALT, np.minimum(depth[:, None], reach))
    for place in np.arange(-4, 5) * LAMP_SPACING_M + rng.uniform(5, 25):
        for way in (-1, 1):
            _street_lamp(canvas, heading, float(place + (way > 0) * LAMP_SPACING_M / 2), way * (HALF_STREET_M - 2.5))


def _street_lamp(canvas: Canvas, heading: float, along: float, aside: float) -> None:
    away = float(np.hypot(along, aside))
    azimuth = (heading + float(np.degrees(np.arctan2(aside, along)))) % 360
    level = LAMP_HEIGHT_M - EYE_HEIGHT_M
    patch = canvas.patch(
        azimuth, float(np.degrees(np.arctan2(0.5, away))), -10.0, float(np.degrees(np.arctan2(level, away)))
    )
    x, y = patch.metres(away)
    pole = strip(x[None, :], 0.0, 0.15, away * np.radians(canvas.step_deg)) * ((y > 0) & (y < LAMP_HEIGHT_M))[:, None]
    canvas.draw(patch, pole, np.array([0.2, 0.2, 0.2]), away)
    gamma = float(np.degrees(np.arctan2(away, level)))
    below_cd = LAMP_KLM * 1000 / (2 * np.pi)
    altitude = float(np.degrees(np.arctan2(level, away)))
    distance = float(np.hypot(level, away))
    canvas.lamps.append(Lamp(azimuth, altitude, distance, lamp_intensity_cd(gamma), below_cd, "LED"))
