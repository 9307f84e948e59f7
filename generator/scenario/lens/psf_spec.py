"""The camera's ``psf`` section: point spread functions and the response of a pixel."""

from __future__ import annotations

import itertools
import math
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from generator.scenario.lens.psf_stack import read_stack
from generator.scenario.strict import File, Strict, listed

Waves = Annotated[float, Field(ge=-5, le=5)]


class MoffatSpec(Strict):
    """Moffat's profile (1 + (r/a)^2)^-beta."""

    fwhm_px: Annotated[float, Field(ge=0.5, le=50)]
    """Full width at half maximum, px."""
    beta: Annotated[float, Field(gt=1.1, le=20)]
    """Exponent; small values give wide wings."""

    @property
    def core_radius_px(self) -> float:
        """The profile's a."""
        return self.fwhm_px / (2 * math.sqrt(2 ** (1 / self.beta) - 1))


class ZernikeSpec(Strict):
    """A term of the wavefront: waves x Zernike polynomial x (field position along u)^u_power x (along v)^v_power.

    Field positions are measured from the principal point and divided by the distance of the corner.
    """

    noll: Annotated[int, Field(ge=4, le=37)]
    """Noll's number of the polynomial (rms 1 over the pupil, x along u, y along v): 4 defocus, 5-6 astigmatism, 7-8 coma."""
    waves: Annotated[float, Field(ge=-2, le=2)]
    """Waves at 550 nm, rms."""
    u_power: Annotated[int, Field(ge=0, le=8)] = 0
    """Power of the field position along u."""
    v_power: Annotated[int, Field(ge=0, le=8)] = 0
    """Power of the field position along v."""


class DiffractionSpec(Strict):
    """A circular pupil with aberrations that grow from the axis; without aberrations, Airy's pattern.

    The wavefront is in waves at 550 nm over the unit pupil (Noll's normalised Zernike polynomials, rms): defocus Z4 is
    the same everywhere, coma Z7/Z8 along the field's radius grows with the radius, and astigmatism Z5/Z6 with its
    square. The values are those at the corner.
    """

    f_number: Annotated[float, Field(ge=0.7, le=64)]
    """Focal ratio."""
    defocus_waves: Waves = 0.0
    coma_waves: Waves = 0.0
    astigmatism_waves: Waves = 0.0
    # Excluded from the scenario's hash unless given, as if the key did not exist.
    zernike: Annotated[tuple[ZernikeSpec, ...], Field(max_length=64), BeforeValidator(listed)] = Field(
        default=(), exclude_if=lambda zernike: not zernike
    )
    """Further terms, each a polynomial of the field position."""

    @property
    def varies(self) -> bool:
        """Whether it varies over the field."""
        return bool(self.coma_waves or self.astigmatism_waves) or any(
            term.waves and (term.u_power or term.v_power) for term in self.zernike
        )


Point = tuple[Annotated[float, Field(ge=0, le=180)], Annotated[float, Field(ge=0, le=20)]]
Curve = Annotated[tuple[Point, ...], Field(min_length=1, max_length=64), BeforeValidator(listed)]


class FieldGaussianSpec(Strict):
    """A Gaussian that widens off axis: standard deviations along and across the field's radius, as functions of the angle."""

    radial_sigma_px: Curve
    """Points [deg off axis, px] of the standard deviation along the radius, at increasing angles; linear between them and
    constant beyond."""
    tangential_sigma_px: Curve
    """Points [deg off axis, px] of the standard deviation across the radius."""

    @model_validator(mode="after")
    def _ordered(self) -> FieldGaussianSpec:
        for name in ("radial_sigma_px", "tangential_sigma_px"):
            angles = [angle for angle, _ in getattr(self, name)]
            if any(later <= earlier for earlier, later in itertools.pairwise(angles)):
                raise ValueError(f"{name}: found the angles {angles}, expected increasing ones")
        return self

    def sigmas_px(self, off_axis_deg: float) -> tuple[float, float]:
        """Standard deviations along and across the radius at an angle off axis."""
        radial, tangential = (
            float(np.interp(off_axis_deg, [angle for angle, _ in curve], [sigma for _, sigma in curve]))
            for curve in (self.radial_sigma_px, self.tangential_sigma_px)
        )
        return radial, tangential


class PixelSpec(Strict):
    """Response within a pixel, normalised to a mean of 1, because the quantum efficiency accounts for insensitive parts."""

    sensitive_width: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Fraction of the pixel's width that is sensitive to light."""
    sensitive_height: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Fraction of the pixel's height that is sensitive to light."""
    diffusion_sigma_px: Annotated[float, Field(ge=0, le=2)] = 0.0
    """Standard deviation of the charge's diffusion before it is collected, px."""


class PsfStackSpec(Strict):
    """Measured or computed point spread functions at equally spaced distances from the principal point."""

    file: File
    """FITS cube (n, rows, columns), or EXR whose channels in alphabetical order are the n functions."""
    oversampling: Annotated[int, Field(ge=1, le=32)]
    """Samples of the stack per pixel."""

    @model_validator(mode="after")
    def _readable(self) -> PsfStackSpec:
        read_stack(self.file, self.oversampling)
        return self


class PsfSpec(Strict):
    """Point spread function: the convolution of the given parts."""

    gaussian_sigma_px: Annotated[float, Field(ge=0.0, le=20)] = 0.0
    moffat: MoffatSpec | None = None
    diffraction: DiffractionSpec | None = None
    defocus_disk_px: Annotated[float, Field(ge=0, le=50)] = 0.0
    """Diameter of the geometric blur disk, px."""
    stack: PsfStackSpec | None = None
    # Excluded from the scenario's hash unless given, as if the keys did not exist.
    field_gaussian: FieldGaussianSpec | None = Field(default=None, exclude_if=lambda given: given is None)
    """A Gaussian that widens off axis."""
    pixel: PixelSpec | None = Field(default=None, exclude_if=lambda given: given is None)
    """Response within a pixel; an even one over the whole pixel unless given."""
    lateral_chromatic_px: Annotated[float, Field(ge=-20, le=20)] = 0.0
    """Distance by which 650 nm falls further from the principal point than 450 nm at the frame's corner, px; linear in both
    wavelength and distance."""
    support_px: Annotated[int, Field(ge=2, le=60)] = 12
    """Half width (along u and v) of the square around a star within which its light is drawn, px."""

    @model_validator(mode="after")
    def _something(self) -> PsfSpec:
        parts = (
            self.gaussian_sigma_px,
            self.moffat,
            self.diffraction,
            self.defocus_disk_px,
            self.stack,
            self.field_gaussian,
        )
        if not any(parts):
            raise ValueError(
                "give at least one of gaussian_sigma_px, moffat, diffraction, defocus_disk_px, stack, field_gaussian"
            )
        return self

    @property
    def varies(self) -> bool:
        """Whether it varies over the field."""
        if self.stack is not None or self.field_gaussian is not None:
            return True
        return self.diffraction is not None and self.diffraction.varies
