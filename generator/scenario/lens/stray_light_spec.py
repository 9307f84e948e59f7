"""Keys of the ``camera`` section for stray light in the lens."""

from __future__ import annotations

import functools
from typing import Annotated

from pydantic import Field, model_validator

from generator.scenario.lens.prescription import PRESCRIPTIONS, Design, first_order_ghosts, focused
from generator.scenario.strict import Strict

LARGEST_GHOST_PX = 500.0
LARGEST_MAGNIFICATION = 10.0


class BloomSpec(Strict):
    """Light that surfaces and dust of the lens scatter into wings (1 + (r / core_px)^2)^(-slope / 2) around its source.

    Everything that shines has wings: stars, planets, the Moon, lamps and the diffuse sky, in the frame and around it.
    """

    share: Annotated[float, Field(ge=0, le=0.6)] = 0.05
    """Fraction of the light, 0-0.6; 0 turns the wings off."""
    core_px: Annotated[float, Field(ge=0.5, le=100)] = 4.0
    """Radius at which the wings begin, px."""
    slope: Annotated[float, Field(ge=1, le=6)] = 2.4
    """Exponent of the wings."""
    reach_px: Annotated[int, Field(ge=2, le=2000)] = 500
    """Radius at which the wings end, px."""


class GhostSpec(Strict):
    """Light reflected twice in the lens: an even disk at a multiple of the point's distance from the principal point."""

    share: Annotated[float, Field(gt=0, le=0.1)]
    """Fraction of the light, 0-0.1."""
    magnification: Annotated[float, Field(ge=-10, le=10)]
    """The disk's distance from the principal point over the point's own; negative on the other side."""
    diameter_px: Annotated[float, Field(ge=2, le=500)]
    """Diameter of the disk, px; at least twice the magnification."""

    @model_validator(mode="after")
    def _without_gaps(self) -> GhostSpec:
        if self.diameter_px < 2 * abs(self.magnification):
            raise ValueError(f"diameter_px: found {self.diameter_px:g}, expected at least twice the magnification")
        return self


class DewSpec(BloomSpec):
    """Droplets in front of the lens: wings like those of `bloom`, wide and steep."""

    share: Annotated[float, Field(ge=0, le=0.5)] = 0.3
    """Fraction of the light, 0-0.5."""
    core_px: Annotated[float, Field(ge=0.5, le=100)] = 30.0
    """Radius at which the wings begin, px: about the angle of diffraction by a droplet, 0.6 degrees at 50 micrometres."""
    slope: Annotated[float, Field(ge=1, le=6)] = 3.0
    """Exponent of the wings: 3, that of Fraunhofer diffraction by droplets of mixed sizes."""


class DustSpec(Strict):
    """Dust on a dome or on the front of the lens: soft round shadows, the same in all frames of a scenario."""

    specks: Annotated[int, Field(ge=1, le=10_000)]
    """Number of specks over the frame."""
    diameter_px: Annotated[float, Field(ge=2, le=500)] = 40.0
    """Mean diameter of their shadows, px; diameters vary by 30 %."""
    mean_depth: Annotated[float, Field(gt=0, le=0.5)] = 0.02
    """Mean fraction of the light that the centre of a shadow loses."""


class ScratchSpec(Strict):
    """Scratches of a dome: streaks of light around bright sources. Short and wide ones are specks of dirt."""

    number: Annotated[int, Field(ge=1, le=50_000)]
    """Number of scratches over the frame; few shine at a time."""
    length_px: Annotated[float, Field(ge=1, le=100)] = 12.0
    """Mean of their lengths, px."""
    width_px: Annotated[float, Field(ge=0.5, le=20)] = 1.5
    """Standard deviation of their profile, px."""
    strength: Annotated[float, Field(gt=0, le=1e-2)] = 1.4e-5
    """Mean fraction of a source's light in an adjacent streak of full brightness."""
    lobe_deg: Annotated[float, Field(ge=2, le=180)] = 25.0
    """Standard deviation of the directions around a scratch from which light makes it shine."""
    # Left out of the scenario's hash unless given, as if the keys did not exist.
    core_deg: Annotated[float, Field(ge=1, le=180)] = Field(default=25.0, exclude_if=lambda core: core == 25.0)
    """Angle from a source at which scratches begin to shine less."""
    slope: Annotated[float, Field(ge=0, le=6)] = Field(default=4.0, exclude_if=lambda slope: slope == 4.0)
    """Exponent of the decrease beyond: (1 + (angle / core_deg)^2)^(-slope / 2)."""
    before_lens: bool = Field(default=False, exclude_if=lambda before: not before)
    """Whether they are on a dome: the lens' vignetting then dims them by their own position, not by that of the source."""


class BarrelRingSpec(Strict):
    """Light from the inner wall of a lens barrel, or from the rims of lenses: a ring around the principal point."""

    radius_px: Annotated[float, Field(gt=0, le=1e5)]
    """Radius of its crest, px; also inside the image circle, for light that a rim reflects."""
    width_px: Annotated[float, Field(ge=1, le=500)] = 8.0
    """Standard deviation of its profile, px."""
    reflectance: Annotated[float, Field(ge=0, le=1)] = 0.02
    """Reflectance of the wall, a Lambert surface lit from the opposite side and seen by the sensor."""
    # Left out of the scenario's hash unless given, as if the key did not exist.
    near_side: Annotated[float, Field(ge=0, le=1)] = Field(default=0.0, exclude_if=lambda part: not part)
    """Fraction of the light from the ring's own side that is scattered onward into it, in a lobe over the azimuth."""
    far_side: Annotated[float, Field(ge=0, le=1)] = Field(default=0.0, exclude_if=lambda part: not part)
    """Fraction of the light from the opposite side that a rim throws back into it, in the same lobe."""
    even: Annotated[float, Field(ge=0, le=1)] = Field(default=0.0, exclude_if=lambda part: not part)
    """Fraction of the mean light in front of the lens that reaches the whole ring evenly."""

    @model_validator(mode="after")
    def _lit(self) -> BarrelRingSpec:
        if not (self.reflectance or self.near_side or self.far_side or self.even):
            raise ValueError("give a reflectance, a near_side, a far_side or an even part above 0")
        return self


class GhostLensSpec(Strict):
    """Ghosts of a public lens design, scaled to the camera's focal length and pupil."""

    design: Design
    """Name of the design."""
    coating_reflectance: Annotated[float, Field(ge=0, le=0.2)] = 0.005
    """Reflectance of each surface between glass and air, 0-1."""
    sensor_reflectance: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Reflectance of the sensor and its window, 0-1."""
    brightest: Annotated[int, Field(ge=1, le=16)] = 6
    """Number of ghosts: those with the brightest disks."""


@functools.lru_cache(maxsize=32)
def ghosts_of(lens: GhostLensSpec, f_px: float, f_number: float | None) -> tuple[GhostSpec, ...]:
    """Return the brightest ghosts of a design in a camera; without `f_number`, the focal ratio is the design's.

    Ghosts that are spread over more than LARGEST_GHOST_PX are left out, because they belong to the veiling glare.
    """
    design = PRESCRIPTIONS[lens.design]
    _, focal_mm = focused(design)
    pupil = 1.0 if f_number is None else design.f_number / f_number
    found: list[GhostSpec] = []
    for ghost in first_order_ghosts(design, lens.coating_reflectance, lens.sensor_reflectance):
        magnification = ghost.shift_mm / focal_mm
        diameter_px = max(pupil * ghost.diameter_mm / focal_mm * f_px, 2.0, 2 * abs(magnification))
        if diameter_px <= LARGEST_GHOST_PX and abs(magnification) <= LARGEST_MAGNIFICATION and ghost.share > 0:
            found.append(GhostSpec(share=ghost.share, magnification=magnification, diameter_px=diameter_px))
    found.sort(key=lambda ghost: -ghost.share / ghost.diameter_px**2)
    return tuple(found[: lens.brightest])
