"""``skybench_stars``: all stars of the sky in one emitter.

=================  =======  =====================================================================================
parameter          type     meaning
=================  =======  =====================================================================================
``directions``     tensor   (n, k, 3): apparent unit vectors (ENU), evenly spaced over the shutter's time, k >= 2
``v_mag``          tensor   (n,): Johnson V above the atmosphere
``colour_row``     tensor   (n,): fractional row of ``colour_table`` (from V-I)
``colour_column``  tensor   (n,): fractional column of ``colour_table`` (from B-V)
``airmass``        tensor   (n,): relative airmass
``colour_table``   tensor   (m, c, k): photon spectra of V = 0 stars, photons s^-1 m^-2 nm^-1, on the wavelength grid
``optical_depth``  tensor   (m, k): of the atmosphere per airmass; m = 1, or those of :mod:`generator.light.airmass_nodes`
``light_curve``    tensor   (n, m), optional: brightness in m equal parts of the shutter's time, relative to ``v_mag``
``dispersion_rad``  tensor  (n, bands), optional: lift of equal bands of the spectral range over ``directions``; 0: none
``step_px``        float    longest step, px, between two moments of the exposure, where that of the point spread function is
                            shorter (default 0): of points that together are a large disk
``horizon_sine``   float    sine of the horizon's apparent altitude, below which nothing shines (default 0)
``hidden``         tensor   (n, 2), optional: first and last share of the shutter's time between which the Moon is in front
``in_front``       bool     whether landscape, geometry and horizon hide none of it: lamps on the ground (default false)
=================  =======  =====================================================================================

Stars are points: camera rays never hit them, so the integrator asks for their positions and irradiances and splats them.
The same emitter lights geometry through Mitsuba's direction sampling, with the same flux.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from generator.device_arrays import aligned
from generator.light.airmass_nodes import AIRMASS_SCALE, largest_airmass
from generator.plugins.scene_tensors import array
from generator.plugins.spectra import ColourTable, SpectralTable, stratified_wavelengths

FLOAT64: Any = dr.float64_array_t(mi.Float)
DISTANCE = 1e6
"""Distance of the stars for shadow rays, scene units."""


class StarEmitter(mi.Emitter):
    """See the module's description."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.m_flags = int(mi.EmitterFlags.Infinite) | int(mi.EmitterFlags.DeltaDirection)
        directions = array(props["directions"], 3)
        if directions.ndim != 3 or directions.shape[1] < 2 or directions.shape[2] != 3:
            raise ValueError(f"skybench_stars: directions must have shape (n, k >= 2, 3), not {directions.shape}")
        self.count, self.keyframes = directions.shape[:2]
        self.components = [FLOAT64(np.ascontiguousarray(directions[:, :, axis]).ravel()) for axis in range(3)]
        v_mag = array(props["v_mag"], 1)
        self.brightness = mi.Float(aligned(10 ** (-0.4 * v_mag)))
        self.colour_row = mi.Float(props["colour_row"].array)
        self.colour_column = mi.Float(props["colour_column"].array)
        self.airmass = mi.Float(props["airmass"].array)
        self.colour_table = ColourTable(props["colour_table"])
        self.optical_depth = SpectralTable(props["optical_depth"])
        self.light_curve = array(props["light_curve"], 2) if "light_curve" in props else None
        if self.light_curve is not None and (self.light_curve.ndim != 2 or len(self.light_curve) != self.count):
            raise ValueError(f"skybench_stars: light_curve must have shape (n, m), not {self.light_curve.shape}")
        middle = directions[:, (self.keyframes - 1) // 2] + directions[:, self.keyframes // 2]
        self.directions_at_middle = middle / np.linalg.norm(middle, axis=1, keepdims=True)
        self.dispersion_rad = array(props["dispersion_rad"], 2) if "dispersion_rad" in props else None
        if self.dispersion_rad is not None and len(self.dispersion_rad) != self.count:
            raise ValueError(
                f"skybench_stars: dispersion_rad must have {self.count} rows, not {len(self.dispersion_rad)}"
            )
        self.hidden = array(props["hidden"], 2) if "hidden" in props else None
        if self.hidden is not None and self.hidden.shape != (self.count, 2):
            raise ValueError(f"skybench_stars: hidden must have shape ({self.count}, 2), not {self.hidden.shape}")
        self.step_px = float(props.get("step_px", 0.0))
        self.lowest_sine = float(props.get("horizon_sine", 0.0))
        self.behind_foreground = not bool(props.get("in_front", False))
        self.choice = mi.DiscreteDistribution(self.brightness) if self.count else None

    def direction(self, star: Any, time: Any) -> tuple[Any, Any, Any]:
        """Components (Float64) of the apparent unit vectors of stars (UInt32 indices) at `time` (0 to 1)."""
        position = dr.clip(FLOAT64(time), 0, 1) * (self.keyframes - 1)
        lower = dr.minimum(mi.UInt32(position), self.keyframes - 2)
        weight = position - FLOAT64(lower)
        index = star * self.keyframes + lower
        east, north, up = (
            dr.lerp(dr.gather(FLOAT64, component, index), dr.gather(FLOAT64, component, index + 1), weight)
            for component in self.components
        )
        norm = 1 / dr.sqrt(east * east + north * north + up * up)
        return east * norm, north * norm, up * norm

    @property
    def up_at_ends(self) -> Any:
        """1 for stars above the horizon when the shutter opens, and when it closes, otherwise 0: (n, 2) array."""
        up = np.array(self.components[2]).reshape(self.count, -1)[:, [0, -1]]
        return (up >= self.lowest_sine).astype(np.float64)

    def open_share(self, star: Any, first: Any, last: Any) -> Any:
        """Part of spans of the shutter's time, (m,) arrays from 0 to 1, in which the Moon hides none of stars (indices)."""
        if self.hidden is None:
            return np.ones(len(first))
        enters, leaves = self.hidden[star].T
        behind = np.clip(np.minimum(leaves, last) - np.maximum(enters, first), 0, None)
        return 1 - np.where(np.isfinite(enters), behind, 0.0) / (last - first)

    def irradiance(self, star: Any, wavelengths: Any) -> Any:
        """Irradiance (Spectrum) at the ground of stars (UInt32 indices), photons s^-1 m^-2 nm^-1."""
        row, column = (dr.gather(mi.Float, place, star) for place in (self.colour_row, self.colour_column))
        shape = self.colour_table.eval(row, column, wavelengths)
        path = dr.gather(mi.Float, self.airmass, star)
        return (
            dr.gather(mi.Float, self.brightness, star)
            * shape
            * dr.exp(-self._depth_per_airmass(path, wavelengths) * path)
        )

    def _depth_per_airmass(self, path: Any, wavelengths: Any) -> Any:
        """Optical depth (Spectrum) per airmass of paths (Float)."""
        if self.optical_depth.rows == 1:
            return self.optical_depth.spectrum(wavelengths)
        last = self.optical_depth.rows - 1
        scale = last / math.log1p(largest_airmass(last + 1) / AIRMASS_SCALE)
        place = dr.log(path * (1 / AIRMASS_SCALE) + 1) * scale
        return self.optical_depth.eval(dr.clip(place, 0, last), wavelengths)

    def set_scene(self, scene: Any) -> None:
        """Mitsuba's interface: stars are infinitely far away, whatever the scene's size."""
        del scene

    def eval(self, si: Any, active: Any = True) -> Any:
        """Mitsuba's interface: a ray never hits a point."""
        del si, active
        return mi.Spectrum(0)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Mitsuba's interface: choose a star by its brightness; the weight is its irradiance over that probability."""
        if self.choice is None:
            return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)
        star, probability = self.choice.sample_pmf(sample.x, active)
        direction = mi.Vector3f(*(mi.Float(component) for component in self.direction(star, it.time)))
        ds = dr.zeros(mi.DirectionSample3f, dr.width(sample.x))
        ds.p = it.p + DISTANCE * direction
        ds.n = -direction
        ds.d = direction
        ds.dist = mi.Float(DISTANCE)
        ds.time = it.time
        ds.pdf = mi.Float(1)
        ds.delta = mi.Bool(True)
        ds.emitter = mi.EmitterPtr(self)
        return ds, dr.select(active, self.irradiance(star, it.wavelengths) / probability, 0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Mitsuba's interface: the density of a point is zero."""
        del it, ds, active
        return mi.Float(0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Mitsuba's interface: as :meth:`eval`."""
        del it, ds, active
        return mi.Spectrum(0)

    def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Mitsuba's interface: uniform over the spectral range."""
        del si, active
        return stratified_wavelengths(sample), mi.Spectrum(1)

    def to_string(self) -> str:
        """Return a short description."""
        return f"StarEmitter[{self.count} stars]"
