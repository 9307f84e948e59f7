"""The scenario's ``sky.clouds`` and ``sky.ground_albedo``."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from generator.light.bake_grids import DEFAULT_ALBEDO
from generator.light.cloud_kinds import CLOUD_KINDS
from generator.scenario.strict import MOST_CURVE_POINTS, Fraction, Strict, increasing, listed


class CloudSpec(Strict):
    """A layer of cloud. Its kind supplies every value that the scenario does not give."""

    kind: Literal["cirrus", "altocumulus", "stratocumulus", "cumulus", "fog"] | None = None
    """Kind of cloud: height, cover, texture, wind, particles, and an optical depth drawn for each day of UTC."""

    altitude_km: Annotated[float, Field(ge=0.2, le=15)] = 8.0
    """Altitude above the ground, km: site.ground_height_m. A layer at the camera's height or below it is left out."""
    mean_optical_depth: Annotated[float, Field(ge=0, le=50)] | None = 0.5
    """Mean vertical optical depth of the layer, clear parts included; with a kind, null means that it is drawn."""
    optical_depth: Annotated[float, Field(ge=0, le=100)] | None = None
    """Mean vertical optical depth of its cloudy part, instead of mean_optical_depth."""
    coverage: Annotated[float, Field(gt=0, le=1)] = 0.7
    """Fraction of the layer that is cloud, 0-1."""
    spectral_slope: Annotated[float, Field(ge=-5, le=-1)] = -8 / 3
    """Exponent of the two-dimensional power spectrum of the Gaussian field behind the cloud."""
    outer_scale_km: Annotated[float, Field(gt=0.5, le=100)] = 20.0
    """Outer scale, above which the power spectrum is flat, km."""
    draw: Annotated[int, Field(ge=0, le=9999)] = 0
    """Number of the pattern: each number gives another pattern of these statistics, from the same seed."""
    wind_m_s: Annotated[float, Field(ge=0, le=150)] = 0.0
    """Speed of the layer, m/s."""
    wind_azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = 90.0
    """Azimuth towards which the layer moves, deg."""
    particle_um: Annotated[float, Field(ge=0, le=1000)] | None = None
    """Effective diameter of droplets or crystals, micrometre: light that large ones diffract stays in a star's image (0:
    none of it). Unless given, 60 from 6 km of altitude on, 20 below."""
    thickness_km: Annotated[float, Field(ge=0, le=5)] = 0.0
    """Thickness over which light spreads sideways on its way through the layer, km; the texture has no shorter waves."""
    star_aureoles: bool = False
    """Whether light that the particles diffract is drawn around stars; otherwise the part outside their images is left
    out."""

    @model_validator(mode="before")
    @classmethod
    def _fill_from_kind(cls, tree: object) -> object:
        if not isinstance(tree, dict):
            return tree
        if tree.get("optical_depth") is not None:
            if tree.get("mean_optical_depth") is not None:
                raise ValueError("give either optical_depth or mean_optical_depth, not both")
            tree = {**tree, "mean_optical_depth": None}
        kind = tree.get("kind")
        if not isinstance(kind, str) or kind not in CLOUD_KINDS:
            return tree
        known = dataclasses.asdict(CLOUD_KINDS[kind])
        usual = {key: known[key] for key in ("altitude_km", "coverage", "outer_scale_km", "wind_m_s", "particle_um")}
        return {**usual, "mean_optical_depth": None, **tree}

    @model_validator(mode="after")
    def _has_a_depth(self) -> CloudSpec:
        if self.mean_optical_depth is None and self.optical_depth is None and self.kind is None:
            raise ValueError("cloud without a kind needs mean_optical_depth or optical_depth")
        return self


GROUND_ALBEDO = {"land": DEFAULT_ALBEDO, "snow": 0.8, "water": 0.06, "desert": 0.3}
"""Grey albedos by name, within the ranges that textbooks of climatology give, among them Oke 1987, "Boundary Layer
Climates" (whose table has not been checked): fresh snow 0.7 to 0.95, deserts 0.2 to 0.45, crops and grass 0.1 to 0.26,
asphalt 0.05 to 0.20, water 0.03 to 0.10. They are for the whole of sunlight; leaves are darker in visible light and
brighter beyond 700 nm."""


def _named_ground(value: object) -> object:
    if isinstance(value, str):
        if value not in GROUND_ALBEDO:
            raise ValueError(f"found {value!r}, expected one of {sorted(GROUND_ALBEDO)}, a number, or points [nm, 0-1]")
        return GROUND_ALBEDO[value]
    return listed(value)


GroundAlbedo = Annotated[
    Fraction
    | Annotated[
        tuple[tuple[Annotated[float, Field(ge=100, le=3000)], Fraction], ...],
        Field(min_length=2, max_length=MOST_CURVE_POINTS),
        AfterValidator(increasing),
    ],
    BeforeValidator(_named_ground),
]
