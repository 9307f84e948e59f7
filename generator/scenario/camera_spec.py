"""The scenario's ``camera`` section: projection, pupil, vignetting and point spread."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationInfo,
    model_validator,
)

from generator.scenario.lens.psf_spec import PsfSpec
from generator.scenario.lens.stray_light_spec import (
    BarrelRingSpec,
    BloomSpec,
    DewSpec,
    DustSpec,
    GhostLensSpec,
    GhostSpec,
    ScratchSpec,
    ghosts_of,
)
from generator.scenario.projection import LensModel, Projection, ProjectionError
from generator.scenario.strict import Fraction, Numbers, Strict, listed

LEAST_DIRECT_SHARE = 0.4
"""Least fraction of the light that bloom, veiling glare and ghosts must leave in the image."""
FOCAL_PX, FARTHEST_CENTRE_PX = (0.01, 1e9), 1e7
"""Focal lengths, and distances of the principal point from the first pixel, that readers of frames accept."""
FISHEYES = ("equidistant", "equisolid", "stereographic", "orthographic", "kannala_brandt")


Rings = Annotated[
    Annotated[BarrelRingSpec, Tag("#one")]
    | Annotated[tuple[BarrelRingSpec, ...], Field(max_length=8), BeforeValidator(listed), Tag("#list")],
    Discriminator(lambda value: "#list" if isinstance(value, list | tuple) else "#one"),
]
Scratches = Annotated[
    Annotated[ScratchSpec, Tag("#one")]
    | Annotated[tuple[ScratchSpec, ...], Field(max_length=8), BeforeValidator(listed), Tag("#list")],
    Discriminator(lambda value: "#list" if isinstance(value, list | tuple) else "#one"),
]


def _field_fits_model(hfov_deg: float | None, info: ValidationInfo) -> float | None:
    limits = {"pinhole": 180.0, "orthographic": 180.0, "equidistant": 360.0, "equisolid": 360.0, "stereographic": 360.0}
    model = info.data.get("model")
    if hfov_deg is not None and model is not None:
        if model not in limits:
            raise ValueError(f"{model} has no simple field of view; give f_px, or focal_length_mm and pixel_pitch_um")
        if hfov_deg >= limits[model]:
            raise ValueError(f"found float {hfov_deg}, expected a value < {limits[model]:g} for the model {model}")
    return hfov_deg


class CameraSpec(Strict):
    """Optics: a projection behind an entrance pupil."""

    preset: str | None = None
    """Camera that supplies the values not given here; see docs/scenarios.md."""
    model: LensModel = "pinhole"
    """Projection."""
    width: Annotated[int, Field(ge=8, le=16384)]
    """Columns, pixels."""
    height: Annotated[int, Field(ge=8, le=16384)]
    """Rows, pixels."""
    hfov_deg: Annotated[Annotated[float, Field(gt=0)] | None, AfterValidator(_field_fits_model)] = None
    """Horizontal field of view, edge to edge, deg; or give f_px, or focal_length_mm and pixel_pitch_um."""
    focal_px: Annotated[float, Field(gt=0, le=1e6)] | None = Field(default=None, alias="f_px")
    """Focal length, px."""
    focal_length_mm: Annotated[float, Field(gt=0, le=1e4)] | None = None
    """Focal length, mm."""
    pixel_pitch_um: Annotated[float, Field(gt=0, le=100)] | None = None
    """Distance between pixel centres along u, micrometres."""
    pixel_aspect: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    """Focal length in px along v over that along u."""
    principal_u_px: float | None = Field(default=None, alias="cx_px")
    """Principal point; the frame's middle unless given."""
    principal_v_px: float | None = Field(default=None, alias="cy_px")
    """Principal point; the frame's middle unless given."""
    k: Numbers = ()
    """Radial distortion: up to k1..k6 (brown_conrady), k1..k4 (kannala_brandt)."""
    p: Numbers = ()
    """Decentring: p1, p2."""
    # Excluded from the scenario's hash unless given, as if the keys did not exist.
    s: Numbers = Field(default=(), exclude_if=lambda s: not s)
    """Thin prism: s1, s2, s3, s4 of OpenCV's twelve coefficients."""
    tilt_rad: Numbers = Field(default=(), exclude_if=lambda tilt_rad: not tilt_rad)
    """Tilt of the sensor about u and v: tau_x, tau_y of OpenCV's fourteen coefficients, rad."""
    image_circle_px: Annotated[float, Field(gt=0, le=1e5)] | None = None
    """Radius around the principal point beyond which no light falls, px."""
    aperture_mm: Annotated[float, Field(gt=0, le=1000)]
    """Diameter of the entrance pupil, mm."""
    pupil: Literal["cosine", "constant"] | None = None
    """Natural vignetting: the pupil's projected area falls with the cosine of the angle off axis, or stays constant, as in
    fisheye lenses, whose pupil turns towards the light. Unless given, it is constant for the fisheye models and follows the
    cosine for the others."""
    vignetting: Numbers = ()
    """Factor 1 + a1 q + a2 q^2 + … on the light, where q is the squared distance from the principal point over that of the
    corner; 0 to 1 as far as the image circle reaches."""
    transmission: Fraction = 0.9
    """Transmission of the lens and filters, 0-1."""
    psf_sigma_px: Annotated[float, Field(ge=0.2, le=20)] = 0.8
    """Standard deviation of the Gaussian point spread function, px, where `psf` is not given."""
    psf: PsfSpec | None = None
    """A point spread function other than the Gaussian."""
    bloom: BloomSpec = BloomSpec()
    """Scatter in the lens."""
    veiling_glare: Annotated[float, Field(ge=0, le=0.2)] = 0.01
    """Fraction of the light that spreads evenly over the sensor, as in ISO 9358: the light of a black spot over that of an
    evenly lit hemisphere around it, wings and ghosts left out."""
    ghosts: Annotated[tuple[GhostSpec, ...], Field(max_length=16), BeforeValidator(listed)] = Field(
        default=(), exclude_if=lambda ghosts: not ghosts
    )
    """Reflections in the lens."""
    ghost_lens: GhostLensSpec | None = None
    """Further reflections: those of a published lens design."""
    dew: DewSpec | None = None
    """Dew on the dome or on the front of the lens."""
    dust: DustSpec | None = None
    """Dust on the dome or on the front of the lens."""
    # Left out of the scenario's hash unless given, as if the keys did not exist.
    scratches: Scratches | None = Field(default=None, exclude_if=lambda scratches: scratches is None)
    """Scratches and specks of dirt on the dome, which shine around bright sources; one kind, or a list."""
    haze: Annotated[float, Field(ge=0, le=0.2)] = Field(default=0.0, exclude_if=lambda haze: not haze)
    """Fraction of the light that a dome or a window in front of the lens scatters evenly over all that the lens sees."""
    barrel_ring: Rings | None = None
    """Rings of light around the image circle; one, or a list."""

    _resting: CameraSpec | None = PrivateAttr(default=None)

    @property
    def resting(self) -> CameraSpec:
        """The camera without drift: its point spread function serves all frames, however little the lens moves."""
        return self._resting or self

    def resting_as(self, resting: CameraSpec) -> CameraSpec:
        """Return this camera as one that has drifted from another."""
        moved = self.model_copy()
        moved._resting = resting
        return moved

    @model_validator(mode="after")
    def _consistent(self) -> CameraSpec:
        ways = [self.hfov_deg is not None, self.focal_px is not None, self.focal_length_mm is not None]
        if sum(ways) != 1:
            raise ValueError("give exactly one of hfov_deg, f_px, and focal_length_mm with pixel_pitch_um")
        if self.focal_length_mm is not None and self.pixel_pitch_um is None:
            raise ValueError("focal_length_mm needs pixel_pitch_um")
        self._check_numbers()
        if self.psf is not None and self.psf.diffraction is not None and self.pixel_pitch_um is None:
            raise ValueError("psf.diffraction needs pixel_pitch_um")
        if self.direct_share < LEAST_DIRECT_SHARE:
            raise ValueError(
                f"bloom, veiling glare, haze and ghosts take {1 - self.direct_share:.2g} of the light, expected at most "
                f"{1 - LEAST_DIRECT_SHARE:.2g} together"
            )
        try:
            self.projection.check_frame(self.width, self.height, self.image_circle_px)
        except ProjectionError as error:
            raise ValueError(str(error)) from error
        corner_px = self.corner_px
        circle_px = corner_px if self.image_circle_px is None else min(self.image_circle_px, corner_px)
        # Outside the image circle there is no light, whatever the polynomial does there.
        for step in range(101):
            q = step / 100 * (circle_px / corner_px) ** 2
            factor = 1 + sum(a * q ** (i + 1) for i, a in enumerate(self.vignetting))
            if not 0 <= factor <= 1 + 1e-9:
                place = f"{corner_px * math.sqrt(q):.1f} px from the principal point"
                raise ValueError(
                    f"vignetting: found a factor {factor:.3g} {place}, inside the frame, expected 0 to 1; correct it, or set "
                    "image_circle_px below"
                )
        return self

    def _check_numbers(self) -> None:
        """Refuse a focal length or a principal point that readers of frames refuse. Raises ValueError."""
        keys = {"hfov_deg": self.hfov_deg, "f_px": self.focal_px, "focal_length_mm": self.focal_length_mm}
        key = next(name for name, value in keys.items() if value is not None)
        try:
            f_px = self.f_px
        except ZeroDivisionError:  # of a field that is rounded to nothing
            f_px = math.inf
        least, most = FOCAL_PX
        if not (least <= f_px <= most and least <= f_px * self.pixel_aspect <= most):
            with_pitch = " and pixel_pitch_um" if key == "focal_length_mm" else ""
            raise ValueError(
                f"{key}: with it{with_pitch} the focal length is {f_px:.3g} px along u and {f_px * self.pixel_aspect:.3g} px "
                f"along v, expected {least:g} to {most:g} px"
            )
        for name, centre_px in (("cx_px", self.principal_u_px), ("cy_px", self.principal_v_px)):
            if centre_px is not None and abs(centre_px) > FARTHEST_CENTRE_PX:
                raise ValueError(
                    f"{name}: found {centre_px:g}, expected a principal point within {FARTHEST_CENTRE_PX:g} px"
                )

    @property
    def direct_share(self) -> float:
        """Fraction of the light that goes into its image: not into wings, veiling glare, haze or ghosts."""
        wings = sum(part.share for part in self.wings)
        return 1 - wings - self.veiling_glare - self.haze - sum(ghost.share for ghost in self.all_ghosts)

    @property
    def wings(self) -> tuple[BloomSpec, ...]:
        """Scatterers that form wings: the lens, and dew on it."""
        return tuple(part for part in (self.bloom, self.dew) if part is not None and part.share)

    @property
    def all_ghosts(self) -> tuple[GhostSpec, ...]:
        """The listed ghosts and those of the design."""
        if self.ghost_lens is None:
            return self.ghosts
        f_number = None
        if self.pixel_pitch_um is not None:
            f_number = self.f_px * self.pixel_pitch_um / 1000 / self.aperture_mm
        return self.ghosts + ghosts_of(self.ghost_lens, self.f_px, f_number)

    @property
    def strays(self) -> bool:
        """Whether there is any stray light on the sensor."""
        return self.direct_share < 1 or bool(self.rings) or bool(self.scratch_kinds)

    @property
    def scratch_kinds(self) -> tuple[ScratchSpec, ...]:
        """Kinds of scratches of the dome."""
        return (self.scratches,) if isinstance(self.scratches, ScratchSpec) else self.scratches or ()

    @property
    def rings(self) -> tuple[BarrelRingSpec, ...]:
        """Rings of light around the image circle."""
        return (self.barrel_ring,) if isinstance(self.barrel_ring, BarrelRingSpec) else self.barrel_ring or ()

    @property
    def f_px(self) -> float:
        """Focal length along u, px."""
        if self.focal_px is not None:
            return self.focal_px
        if self.hfov_deg is not None:
            half = math.radians(self.hfov_deg / 2)
            radius = {
                "pinhole": math.tan,
                "equidistant": lambda t: t,
                "equisolid": lambda t: 2 * math.sin(t / 2),
                "stereographic": lambda t: 2 * math.tan(t / 2),
                "orthographic": math.sin,
            }[self.model](half)
            return self.width / 2 / radius
        if self.focal_length_mm is None or self.pixel_pitch_um is None:
            raise ValueError("no focal length")
        return 1000 * self.focal_length_mm / self.pixel_pitch_um

    @property
    def projection(self) -> Projection:
        """The projection's numbers."""
        return Projection(
            model=self.model,
            f_px=self.f_px,
            fy_px=self.f_px * self.pixel_aspect,
            cx_px=(self.width - 1) / 2 if self.principal_u_px is None else self.principal_u_px,
            cy_px=(self.height - 1) / 2 if self.principal_v_px is None else self.principal_v_px,
            k=self.k,
            p=self.p,
            s=self.s,
            tilt_rad=self.tilt_rad,
        )

    @property
    def corner_px(self) -> float:
        """Distance of the frame's furthest corner from the principal point, px."""
        return self.projection.corner_px(self.width, self.height)

    @property
    def pupil_law(self) -> str:
        """``cosine`` or ``constant``."""
        return self.pupil or ("constant" if self.model in FISHEYES else "cosine")
