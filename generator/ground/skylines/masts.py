"""Masts: a lattice mast with obstruction lights, and a line of poles with wires; all thinner than most pixels.

Obstruction lights are steady and red: low intensity, type B, 32 cd, as manufacturers of such lights quote from ICAO's
Annex 14, volume I, chapter 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.ground.lamp import Lamp
from generator.ground.panorama import EYE_HEIGHT_M
from generator.ground.skylines.canvas import COLUMNS, Canvas, strip

Floats = NDArray[np.float64]

STEEL = np.array([0.25, 0.25, 0.26])
WOOD = np.array([0.10, 0.08, 0.06])
OBSTRUCTION_LIGHT_CD = 32.0
POLE_SPACING_M = 45.0
POLE_HEIGHT_M = 9.0
WIRE_MM = 12.0
SAG_M = 0.9


def draw_masts(canvas: Canvas) -> None:
    """Draw a line of poles with three wires past the camera, and two lattice masts."""
    rng = canvas.rng
    for _ in range(2):
        _lattice(canvas, rng.uniform(0, 360), rng.uniform(60, 250), rng.uniform(35, 70))
    _pole_line(canvas, rng.uniform(0, 360), rng.uniform(10, 25))


def _lattice(canvas: Canvas, azimuth: float, away: float, height: float) -> None:
    """Three legs that meet at the top, and diagonals between them."""
    top = float(np.degrees(np.arctan2(height - EYE_HEIGHT_M, away)))
    patch = canvas.patch(azimuth, float(np.degrees(np.arctan2(3.0, away))), 0.0, top)
    x, y = patch.metres(away)
    x, y = x[None, :], y[:, None]
    step = away * np.radians(canvas.step_deg) / np.cos(np.radians(patch.altitude_deg))[:, None]
    half = 1.5 * np.clip(1 - y / height, 0.06, 1)
    inside = (y > 0) & (y < height)
    alpha = np.zeros(patch.shape)
    for leg in (-1.0, 0.1, 1.0):
        alpha = np.maximum(alpha, strip(x, leg * half, 0.12, step) * inside)
    zigzag = half * (np.abs((y / 2.5 % 2) - 1) * 2 - 1)
    for way in (-1, 1):
        alpha = np.maximum(alpha, strip(x, way * zigzag, 0.06, step) * inside)
    canvas.draw(patch, alpha, STEEL, away)
    for share in (0.5, 1.0):
        level = share * height - EYE_HEIGHT_M
        altitude = float(np.degrees(np.arctan2(level, away)))
        distance = float(np.hypot(level, away))
        canvas.lamps.append(Lamp(azimuth % 360, altitude, distance, OBSTRUCTION_LIGHT_CD, 0.0, "red"))


def _pole_line(canvas: Canvas, heading: float, aside: float) -> None:
    """Poles along a straight line that passes the camera at a distance, with wires that hang in parabolas between them."""
    along = (np.arange(-6, 7) + canvas.rng.random()) * POLE_SPACING_M
    for place in along:
        azimuth = heading + float(np.degrees(np.arctan2(aside, place)))
        away = float(np.hypot(place, aside))
        top = float(np.degrees(np.arctan2(POLE_HEIGHT_M - EYE_HEIGHT_M, away)))
        patch = canvas.patch(azimuth, float(np.degrees(np.arctan2(1.0, away))), -5.0, top)
        x, y = patch.metres(away)
        step = away * np.radians(canvas.step_deg)
        pole = strip(x[None, :], 0.0, 0.28, step) * ((y > 0) & (y < POLE_HEIGHT_M))[:, None]
        across = strip(y[:, None], POLE_HEIGHT_M - 0.5, 0.12, step) * (np.abs(x) < 0.9)[None, :]
        canvas.draw(patch, np.maximum(pole, across), WOOD, away)
    turn = np.radians((canvas.azimuth_deg - heading) % 360)
    faces = np.sin(turn) > 1e-3
    for shift in (-0.7, 0.0, 0.7):
        side = aside + shift
        along_line = side / np.where(faces, np.tan(turn), 1.0)
        hung = faces & (along_line > along[0]) & (along_line < along[-1])
        share = ((along_line - along[0]) / POLE_SPACING_M) % 1.0
        height = POLE_HEIGHT_M - 0.4 - SAG_M * 4 * share * (1 - share) - EYE_HEIGHT_M
        wire_away = side / np.where(faces, np.sin(turn), 1.0)
        level = np.degrees(np.arctan2(height, wire_away))
        thick = np.degrees(np.arctan2(WIRE_MM / 1000, wire_away))
        high = float(level[hung].max())
        patch = canvas.whole(0.0, high)
        columns = patch.columns % COLUMNS
        alpha = strip(patch.altitude_deg[:, None], level[columns][None, :], thick[columns][None, :], canvas.step_deg)
        canvas.draw(patch, alpha * hung[columns][None, :], STEEL * 0.4, wire_away[columns][None, :])
