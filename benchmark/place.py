"""Position of a camera on the Earth."""

from __future__ import annotations

from dataclasses import dataclass

from benchmark.errors import PhotographError
from generator.light.atmosphere import usual_pressure_hpa, usual_temperature_c
from generator.places.astrometry import Air

USUAL_HUMIDITY = 0.5


@dataclass(frozen=True)
class Place:
    """Position of a camera: WGS84, longitude east positive, height above the ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0

    def __post_init__(self) -> None:
        limits = {"latitude_deg": 90.0, "longitude_deg": 360.0, "height_m": 30_000.0}
        for name, limit in limits.items():
            if not abs(getattr(self, name)) <= limit:
                raise PhotographError(f"site: {name} {getattr(self, name)!r} is not within {-limit:g} to {limit:g}")

    @property
    def air(self) -> Air:
        """Air that is usual at this height."""
        return Air(float(usual_pressure_hpa(self.height_m)), float(usual_temperature_c(self.height_m)), USUAL_HUMIDITY)
