"""Values of a scenario that cannot both be true of one place or one camera."""

from __future__ import annotations

import numpy as np

from generator.light.atmosphere import pressure_contradicts, standard_pressure_hpa
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.file import Scenario
from generator.scenario.model import FrameSpec, LocalAtmosphereSpec
from generator.scenario.projection import PINHOLE_LIKE

MOST_FRAMES = 32
"""Largest number of frames of a scenario that are checked for contradictions."""
LEAST_ILLUMINATION = 0.2
"""Mean light of the pixels of an evenly lit frame, relative to the axis, below which a veiling glare looks like a mistake."""


def contradictions(spec: FrameSpec) -> tuple[str, ...]:
    """Contradictions between values of a frame; each a sentence that begins with the key."""
    found = []
    pressure_hpa, height_m = spec.atmosphere.pressure_hpa, spec.site.height_m
    if pressure_contradicts(pressure_hpa, height_m):
        found.append(
            f"atmosphere.pressure_hpa: {pressure_hpa:g} contradicts the site's height of {height_m:g} m, "
            f"where it is about {float(standard_pressure_hpa(height_m)):.0f}; leave it out, and it follows the height"
        )
    sky = spec.sky
    if key := next((key for key in ("bortle", "zenith_mag_arcsec2", "cities") if getattr(sky, key)), None):
        if "skyglow" not in sky.active_components:
            found.append(
                f"sky.{key}: makes no sky brighter that has no 'skyglow' among sky.components; add it, or leave {key} out"
            )
        elif not _scatters(spec.atmosphere):
            found.append(
                f"sky.{key}: makes no sky brighter without air that scatters city light (atmosphere.pressure_hpa and "
                f"atmosphere.aerosol_tau_550 are 0); raise one of them, or leave {key} out"
            )
        elif key != "cities" and sky.cities == ():
            found.append(
                f"sky.cities: an empty list leaves no lamps that make the sky as bright as {key} says; "
                f"name a city, or leave cities out for the usual ones, or {key} for a natural sky"
            )
    glare, lit = spec.camera.veiling_glare, mean_illumination(spec.camera)
    if glare and lit < LEAST_ILLUMINATION:
        found.append(
            f"camera.veiling_glare: {glare:g} of the light of a pixel on the axis is {glare / lit:.2g} of that of a mean "
            f"pixel, since a {spec.camera.model} lens so wide darkens outwards; lower it, or take a fisheye"
        )
    return tuple(found)


def mean_illumination(camera: CameraSpec) -> float:
    """Mean light of the pixels under an even sky, relative to the axis, of a rectilinear lens by its cos^4; 1 for others."""
    if camera.model not in PINHOLE_LIKE:
        return 1.0
    lens = camera.projection
    x = (np.linspace(0, camera.width - 1, 101) - lens.cx_px) / lens.f_px
    y = (np.linspace(0, camera.height - 1, 101) - lens.cy_px) / lens.fy_px
    return float(np.mean((1 + x**2 + y[:, None] ** 2) ** -2))


def _scatters(air: LocalAtmosphereSpec) -> bool:
    """Whether city light is scattered: without extinction it is that of standard air."""
    return not air.extinction or air.pressure_hpa > 0 or air.aerosol_tau_550 > 0


def contradictions_of(scenario: Scenario) -> tuple[str, ...]:
    """Contradictions in up to MOST_FRAMES evenly spaced frames of a scenario, each once, for the first frame that has it.

    Raises
    ------
    ScenarioError
        A frame's values are not acceptable.
    TimeRangeError
        A frame's exposure is outside the Earth orientation table.
    """
    count = scenario.frame_count
    found: dict[str, int] = {}
    for place in range(min(count, MOST_FRAMES)):
        index = place * count // min(count, MOST_FRAMES)
        for sentence in contradictions(scenario.frame(index)):
            found.setdefault(sentence, index)
    said = [f"{scenario.source}: frame {index}: {sentence}" for sentence, index in found.items()]
    if len(said) > 1:
        return said[0], f"{scenario.source}: and {len(said) - 1} more of this kind"
    return tuple(said)
