"""Lamps in view."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from generator.ground.lamp import Lamp
from generator.scenario.strict import Strict


class LampSpec(Strict):
    """A lamp in front of the sky and of everything else; the lens produces its glare."""

    azimuth_deg: Annotated[float, Field(ge=-360, le=360)]
    altitude_deg: Annotated[float, Field(ge=-90, le=90)]
    distance_m: Annotated[float, Field(ge=1, le=100_000)]
    intensity_cd: Annotated[float, Field(gt=0, le=1e8)]
    """Luminous intensity towards the camera, cd."""
    downward_cd: Annotated[float, Field(ge=0, le=1e8)] = 0.0
    """Luminous intensity below the horizontal, which lights the landscape, cd."""
    kind: Literal["HPS", "LED", "LED3000", "MH", "mercury", "red"] = "LED"
    """Spectrum: high-pressure sodium, white diodes, metal halide, mercury, or a red obstruction light."""

    def lamp(self) -> Lamp:
        """The lamp in the form that the landscape uses."""
        return Lamp(
            self.azimuth_deg, self.altitude_deg, self.distance_m, self.intensity_cd, self.downward_cd, self.kind
        )
