"""Changes of the sky or of the lens, one thing at a time; solvers receive no information about them, or only their size.

Displacements act on the apparent directions of the stars before they are imaged, so they do not depend on how the generator
computes positions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from generator.frame.plan import FramePlan
from generator.places.times import Instant

F8 = NDArray[np.float64]

ARCSEC = math.radians(1.0 / 3600.0)
UNPERTURBED = "none"
HIPPARCOS_EPOCH = Instant.parse("1991-04-02T13:30:00Z")
HIPPARCOS_PLACE_ARCSEC, HIPPARCOS_MOTION_ARCSEC = 0.77e-3, 0.88e-3
_YEAR_S = 365.25 * 86400.0
REFRACTION_NM = 550.0
PRECESSION_RATE_ARCSEC = 0.29965
ROTATION_ARCSEC_S = 15.041067
"""Earth rotation, arcsec of angle per second of UT1 (IERS Conventions 2010, equation 5.15)."""

Displace = Callable[[FramePlan, F8, np.random.Generator], F8]
"""Maps directions (n, 3) of a plan's stars to directions (n, 3); called once per moment with the same random numbers."""


@dataclass(frozen=True)
class SuppliedSizes:
    """Standard deviations that the observations of perturbed frames state, see `benchmark.protocol.Observation`."""

    tilt_sigma_deg: float
    pressure_sigma_hpa: float = 0.0


@dataclass(frozen=True, eq=False)
class Perturbation:
    """One difference between the frames and what solvers assume.

    Attributes
    ----------
    key : str
        Key for files.
    title, source : str
        Description of the change, and source of its size.
    displace : callable, optional
        Displacement of the stars' directions.
    psf : mapping
        Keys of the scenario's ``camera.psf`` that replace its own.
    told : SuppliedSizes, optional
        What solvers receive about it; None for nothing.
    rendered_as : str, optional
        Key of the perturbation whose frames are used, None for its own: two that differ in what solvers receive share frames.
    """

    key: str
    title: str
    source: str
    displace: Displace | None = None
    psf: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    told: SuppliedSizes | None = None
    rendered_as: str | None = None

    @property
    def frames_key(self) -> str:
        """Key of the frames, which names their folder and their random numbers."""
        return self.rendered_as or self.key


def turned(directions: F8, axis: F8, angle_rad: float) -> F8:
    """Rotate unit vectors (n, 3) about a unit axis (Rodrigues' formula)."""
    along = (directions @ axis)[:, None] * axis
    across = directions - along
    return np.asarray(along + math.cos(angle_rad) * across + math.sin(angle_rad) * np.cross(axis, directions))


def scattered(directions: F8, sigma_rad: float, rng: np.random.Generator) -> F8:
    """Displace unit vectors (n, 3) by Gaussian amounts with a standard deviation along each of two perpendicular axes."""
    step = rng.normal(scale=sigma_rad, size=directions.shape)
    step -= np.sum(step * directions, axis=1, keepdims=True) * directions
    moved = directions + step
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def raised(directions: F8, angle_rad: F8) -> F8:
    """Move apparent directions (n, 3) towards the zenith by angles (n,); those that pass it descend on the other side."""
    level = np.hypot(directions[:, 0], directions[:, 1])
    altitude = np.arctan2(directions[:, 2], level) + angle_rad
    around = directions[:, :2] / np.where(level > 0, level, 1.0)[:, None]
    return np.column_stack((np.cos(altitude)[:, None] * around, np.sin(altitude)))


def _catalogue(plan: FramePlan, directions: F8, rng: np.random.Generator) -> F8:
    years = plan.utc_mid.since(HIPPARCOS_EPOCH) / _YEAR_S
    return scattered(directions, math.hypot(HIPPARCOS_PLACE_ARCSEC, years * HIPPARCOS_MOTION_ARCSEC) * ARCSEC, rng)


def _arcsecond(plan: FramePlan, directions: F8, rng: np.random.Generator) -> F8:
    return scattered(directions, ARCSEC, rng)


def _refraction(plan: FramePlan, directions: F8, rng: np.random.Generator) -> F8:
    air = plan.spec.atmosphere
    refa, refb = erfa.refco(air.pressure_hpa, air.temperature_c, air.relative_humidity, REFRACTION_NM / 1000.0)
    tangent = np.hypot(directions[:, 0], directions[:, 1]) / directions[:, 2]
    return raised(directions, 0.03 * (refa * tangent + refb * tangent**3) + 5.0 * ARCSEC)


def _vertical(plan: FramePlan, directions: F8, rng: np.random.Generator) -> F8:
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    return turned(directions, np.array([math.sin(azimuth), math.cos(azimuth), 0.0]), math.radians(0.01))


def _rotation(plan: FramePlan, directions: F8, rng: np.random.Generator) -> F8:
    latitude = math.radians(plan.spec.site.latitude_deg)
    pole = np.array([0.0, math.cos(latitude), math.sin(latitude)])
    # The sky turns from east to west, which is left-handed about the northern pole.
    return turned(directions, pole, -0.1 * ROTATION_ARCSEC_S * ARCSEC)


def _precession(plan: FramePlan, directions: F8, rng: np.random.Generator) -> F8:
    obliquity = math.radians(23.4393)
    ecliptic_pole = plan.sky.icrs_from_enu.T @ np.array([0.0, -math.sin(obliquity), math.cos(obliquity)])
    centuries = plan.utc_mid.since(Instant.parse("2000-01-01T12:00:00Z")) / (100.0 * _YEAR_S)
    return turned(directions, ecliptic_pole, PRECESSION_RATE_ARCSEC * centuries * ARCSEC)


def _lens(waves: float) -> Perturbation:
    return Perturbation(
        f"coma-{waves:g}",
        f"coma and astigmatism of {waves:g} waves",
        "rms at 550 nm in the corner, f/2.8; fast lenses wide open",
        psf={"diffraction": {"f_number": 2.8, "coma_waves": waves, "astigmatism_waves": waves}, "support_px": 24},
    )


PERTURBATIONS = (
    Perturbation(
        "catalogue",
        "catalogue: 20 to 30 mas",
        "median standard errors of Hipparcos, 0.77 mas at 1991.25 and 0.88 mas a year (ESA SP-1200, 1997, volume 1)",
        _catalogue,
    ),
    Perturbation("catalogue-1arcsec", "catalogue: 1 arcsec", "forty times the above, for scale", _arcsecond),
    Perturbation(
        "refraction",
        "refraction +3 % and +5 arcsec",
        "3 %: pressure off by 30 hPa or temperature by 8 K; 5 arcsec: anomalous refraction at its most",
        _refraction,
    ),
    Perturbation(
        "refraction-told",
        "refraction +3 % and +5 arcsec, sizes supplied",
        "the frames of the above; solvers receive standard deviations of 30 hPa and, for the vertical, of 5 arcsec",
        _refraction,
        told=SuppliedSizes(5.0 / 3600.0, 30.0),
        rendered_as="refraction",
    ),
    Perturbation(
        "vertical", "vertical off by 0.01 deg", "1.1 km of position, whatever a solver does", _vertical
    ),
    Perturbation(
        "vertical-told",
        "vertical off by 0.01 deg, size supplied",
        "the frames of the above; solvers receive a standard deviation of 0.01 deg / sqrt 2 about each axis",
        _vertical,
        told=SuppliedSizes(0.01 / math.sqrt(2.0)),
        rendered_as="vertical",
    ),
    Perturbation(
        "rotation",
        "UT1 off by 0.1 s",
        "IERS Bulletin A foretells UT1 to 0.25 ms times days^0.75: eight years without a new table",
        _rotation,
    ),
    Perturbation(
        "precession",
        "precession of 1976",
        "rate of longitude 0.29965 arcsec a century too fast (IAU 2000, Capitaine et al. 2003)",
        _precession,
    ),
    *(_lens(waves) for waves in (0.6, 1.0, 1.5)),
    Perturbation(
        "moffat", "Moffat profile with beta 2.5", "wings of real lenses and air; full width 2.2 px",
        psf={"gaussian_sigma_px": 0.0, "diffraction": None, "moffat": {"fwhm_px": 2.2, "beta": 2.5}, "support_px": 24},
    ),
)  # fmt: skip
