"""Values of a scenario that cannot both be true of one place."""

from __future__ import annotations

from generator.light.atmosphere import pressure_contradicts, standard_pressure_hpa
from generator.scenario.file import Scenario
from generator.scenario.model import FrameSpec, LocalAtmosphereSpec

MOST_FRAMES = 32
"""Largest number of frames of a scenario that are checked for contradictions."""


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
    if sky.bortle is not None or sky.zenith_mag_arcsec2 is not None:
        key = "bortle" if sky.bortle is not None else "zenith_mag_arcsec2"
        if "skyglow" not in sky.active_components:
            found.append(
                f"sky.{key}: makes no sky brighter that has no 'skyglow' among sky.components; add it, or leave {key} out"
            )
        elif not _scatters(spec.atmosphere):
            found.append(
                f"sky.{key}: makes no sky brighter without air that scatters city light (atmosphere.pressure_hpa and "
                f"atmosphere.aerosol_tau_550 are 0); raise one of them, or leave {key} out"
            )
    return tuple(found)


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
