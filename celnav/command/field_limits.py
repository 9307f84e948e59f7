"""The camera's field of view, and the narrowest fields that the solvers were made for."""

from __future__ import annotations

import math

import numpy as np

from celnav.camera import Camera
from celnav.sky.catalog import load_catalog

# Limit of the deepest catalogue of the thesis' solvers (`celnav.matching.patterns`). If the field has fewer of its stars,
# they mostly refuse (docs/celnav.md, "Measured").
_THESIS_V_MAG = 4.5
_THESIS_STARS = 15
# Narrower fields contain fewer catalogue stars than an identification needs (docs/solver.md, "Hypotheses").
_SKYBENCH_DEG = 5.0


def field_deg(camera: Camera) -> tuple[float, float]:
    """Return width and height of the field, degrees, through the principal point, to the edges or the image circle."""

    def across(n: int, at: float, column: bool) -> float:
        along = np.linspace(-0.5, n - 0.5, 201)
        other = np.full_like(along, at)
        rays = camera.to_rays(np.column_stack((other, along) if column else (along, other)))
        angle = np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
        before = along < (camera.cy_px if column else camera.cx_px)
        ends = [angle[side & np.isfinite(angle)] for side in (before, ~before)]
        return float(sum(end.max() for end in ends if len(end)))

    return across(camera.width, camera.cy_px, False), across(camera.height, camera.cx_px, True)


def field_limit(camera: Camera, solver: str) -> str:
    """Return the limit of the solver that the field violates, as a sentence; empty if there is none."""
    width, height = field_deg(camera)
    field = f"the field of {width:.3g} x {height:.3g} deg"
    if solver == "skybench":
        if max(width, height) >= _SKYBENCH_DEG:
            return ""
        return f"{field} is narrower than {_SKYBENCH_DEG:g} deg, the least that solver skybench is measured with"
    stars = int(np.sum(load_catalog().v_mag <= _THESIS_V_MAG)) * camera.solid_angle_sr / (4 * math.pi)
    if stars >= _THESIS_STARS:
        return ""
    return (
        f"{field} holds about {stars:.0f} stars of V <= {_THESIS_V_MAG:g}, where the catalogue of solver {solver} ends; it "
        f"needs {_THESIS_STARS} or more"
    )
