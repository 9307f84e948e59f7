"""``skybench_sky``: the diffuse night sky as an environment emitter.

Radiance is the sum over components of a function of direction times a spectrum: airglow (a thin layer, dimmed by the
atmosphere) and artificial skyglow (a power of the airmass). The formulas are those of :mod:`generator.sky_brightness`.

======================  =======  ==================================================================================
parameter               type     meaning
======================  =======  ==================================================================================
``airglow``             tensor   (1, n): zenith radiance above the atmosphere on the generator's wavelength grid
``artificial``          tensor   (1, n): zenith radiance at the ground
``optical_depth``       tensor   (1, n): vertical optical depth that acts on airglow
======================  =======  ==================================================================================

Radiance in photons s^-1 m^-2 nm^-1 sr^-1. The scene's z axis is up; the sky is black below the horizon.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from generator.plugins.spectra import SpectralTable, stratified_wavelengths
from generator.sky_brightness import AIRGLOW_LAYER_KM, ARTIFICIAL_AIRMASS_EXPONENT, EARTH_RADIUS_KM

DISTANCE = 1e6
"""How far away, in scene units, the sky is put for shadow rays."""

UNIFORM_HEMISPHERE_DENSITY = 0.5 / math.pi

ZENITH_AIRMASS = 0.99971
"""Kasten & Young's formula at the zenith."""


def airmass(cosine: Any) -> Any:
    """Kasten & Young's airmass (:func:`generator.atmosphere.airmass`) from the cosine of the zenith angle, Dr.Jit."""
    cosine = dr.clip(cosine, 0, 1)
    altitude_deg = dr.rad2deg(dr.asin(cosine))
    return dr.rcp(cosine + 0.50572 * dr.power(altitude_deg + 6.07995, -1.6364))


class DiffuseSkyEmitter(mi.Emitter):
    """See the module's description."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.m_flags = int(mi.EmitterFlags.Infinite) | int(mi.EmitterFlags.SpatiallyVarying)
        self.airglow = SpectralTable(props["airglow"])
        self.artificial = SpectralTable(props["artificial"])
        self.optical_depth = SpectralTable(props["optical_depth"])

    def is_environment(self) -> bool:
        """Mitsuba's interface: rays that leave the scene end here."""
        return True

    def set_scene(self, scene: Any) -> None:
        """Mitsuba's interface: the sky is infinitely far away, whatever the scene's size."""
        del scene

    def radiance(self, direction: Any, wavelengths: Any) -> Any:
        """Radiance (Spectrum) that arrives from unit vectors `direction` (Vector3f, ENU)."""
        path = airmass(direction.z)
        sine = dr.safe_sqrt(1 - dr.square(direction.z)) * (EARTH_RADIUS_KM / (EARTH_RADIUS_KM + AIRGLOW_LAYER_KM))
        van_rhijn = dr.rsqrt(1 - sine * sine)
        dimmed = dr.exp(-self.optical_depth.spectrum(wavelengths) * path)
        glow = self.airglow.spectrum(wavelengths) * dimmed * van_rhijn
        gradient = dr.power(path / ZENITH_AIRMASS, ARTIFICIAL_AIRMASS_EXPONENT)
        return dr.select(direction.z >= 0, glow + self.artificial.spectrum(wavelengths) * gradient, 0)

    def eval(self, si: Any, active: Any = True) -> Any:
        """Mitsuba's interface: radiance along the ray that ended in `si`."""
        return dr.select(active, self.radiance(-si.wi, si.wavelengths), 0)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Mitsuba's interface, for light on geometry: uniform over the upper hemisphere."""
        direction = mi.warp.square_to_uniform_hemisphere(sample)
        ds = dr.zeros(mi.DirectionSample3f, dr.width(sample))
        ds.p = it.p + DISTANCE * direction
        ds.n = -direction
        ds.d = direction
        ds.dist = mi.Float(DISTANCE)
        ds.uv = sample
        ds.time = it.time
        ds.pdf = mi.Float(UNIFORM_HEMISPHERE_DENSITY)
        ds.emitter = mi.EmitterPtr(self)
        radiance = self.radiance(direction, it.wavelengths)
        return ds, dr.select(active, radiance / UNIFORM_HEMISPHERE_DENSITY, 0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Mitsuba's interface: density of :meth:`sample_direction`, per sr."""
        del it
        return dr.select(active & (ds.d.z >= 0), mi.Float(UNIFORM_HEMISPHERE_DENSITY), 0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Mitsuba's interface: radiance from the sampled direction."""
        return dr.select(active, self.radiance(ds.d, it.wavelengths), 0)

    def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Mitsuba's interface: uniform over the spectral range."""
        del si, active
        return stratified_wavelengths(sample), mi.Spectrum(1)

    def to_string(self) -> str:
        """Return a short description."""
        return "DiffuseSkyEmitter[airglow, artificial]"
