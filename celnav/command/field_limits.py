"""The camera's field of view, and which solvers were made for so narrow a one."""

from __future__ import annotations

import math

import numpy as np

from celnav.camera import Camera
from celnav.sky.catalog import load_catalog

# Of the catalogues of the thesis' solvers the deepest ends here (`celnav.matching.patterns`), and with fewer stars of the
# field they mostly refuse (docs/celnav.md, "Measured").
_THESIS_V_MAG = 4.5
_THESIS_STARS = 15
# Narrower ones hold fewer stars of the catalogue than an identification takes (docs/solver.md, "Hypotheses").
_SKYBENCH_DEG = 5.0


def field_deg(camera: Camera) -> tuple[float, float]:
    """Width and height of the field, degrees: through the principal point from edge to edge, or to the image circle."""

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
    """Return the limit of the solver that the field falls short of, as a sentence; empty where it keeps them all."""
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
