"""``skybench_stars``: all stars of the sky in one emitter.

=================  =======  =====================================================================================
parameter          type     meaning
=================  =======  =====================================================================================
``directions``     tensor   (n, k, 3): apparent unit vectors (ENU), evenly spaced over each star's own time, k >= 2
``v_mag``          tensor   (n,): Johnson V above the atmosphere
``colour_row``     tensor   (n,): fractional row of ``colour_table`` (from V-I)
``colour_column``  tensor   (n,): fractional column of ``colour_table`` (from B-V)
``airmass``        tensor   (n,): relative airmass
``colour_table``   tensor   (m, c, k): photon spectra of V = 0 stars, photons s^-1 m^-2 nm^-1, on the wavelength grid
``optical_depth``  tensor   (m, k): optical depth per airmass; m = 1, or at the nodes of :mod:`generator.light.airmass_nodes`
``lit``            tensor   (n, 2), optional: start and length of each star's own time, dark outside; default: the shutter's
``parts``          tensor   (n,), with ``lit``: number of equal parts of each star's own time
``light_curve``    tensor   (sum of parts,), with ``lit``: brightness in these, relative to ``v_mag``, star by star
``dispersion_rad``  tensor  (n, bands), optional: lift of equal bands of the spectral range over ``directions``; 0: none
``step_px``        float    longest step, px, between two moments of the exposure, where that of the point spread function is
                            shorter (default 0): of points that together are a large disk
``horizon_sine``   float    sine of the horizon's apparent altitude, below which nothing shines (default 0)
``hidden``         tensor   (n, 2), optional: first and last share of the shutter's time between which the Moon is in front
``in_front``       bool     whether nothing (landscape, geometry, horizon) hides it: lamps on the ground (default false)
=================  =======  =====================================================================================

Stars are points: camera rays never hit them, so the integrator asks for their positions and irradiances and splats them.
The same emitter lights geometry through Mitsuba's direction sampling, with the same flux.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned
from generator.light.airmass_nodes import AIRMASS_SCALE, largest_airmass
from generator.plugins.scene_tensors import array
from generator.plugins.spectra import ColourTable, SpectralTable, stratified_wavelengths

FLOAT64: Any = dr.float64_array_t(mi.Float)
DISTANCE = 1e6
"""Distance of the stars for shadow rays, scene units."""
END_SLACK = 1e-6
"""Tolerance of the shutter's time, for the rounding of `lit` to single precision."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OwnTimes:
    """Time span of each of n stars within the shutter's time (0 to 1), and brightness over it.

    Attributes
    ----------
    start, length : (n,) arrays
    parts, first_part : (n,) int arrays
        Number of equal parts of its own time span, and index of the first in `light_curve`.
    light_curve : (sum of parts,) array
    on_device : tuple of Float64
        `start` and 1 / `length`.
    """

    start: Floats
    length: Floats
    parts: NDArray[np.int64]
    first_part: NDArray[np.int64]
    light_curve: Floats
    on_device: tuple[Any, Any]

    @classmethod
    def of(cls, props: Any, count: int) -> OwnTimes:
        """Return those of an emitter's parameters."""
        lit, parts, curve = array(props["lit"], 2), array(props["parts"], 1), array(props["light_curve"], 1)
        if lit.shape != (count, 2) or parts.shape != (count,) or curve.shape != (int(parts.sum()),):
            raise ValueError(
                "skybench_stars: lit, parts and light_curve must have shapes (n, 2), (n,) and (sum of parts,), not "
                f"{lit.shape}, {parts.shape} and {curve.shape}"
            )
        parts = parts.astype(np.int64)
        start, length = (np.ascontiguousarray(column) for column in lit.T)
        on_device = (FLOAT64(aligned(start)), FLOAT64(aligned(1 / length)))
        return cls(start, length, parts, np.cumsum(parts) - parts, curve, on_device)

    @property
    def end(self) -> Floats:
        """End of each own time span, (n,) array; single-precision values close to the shutter's end become its end."""
        end = self.start + self.length
        return np.where(end > 1 - END_SLACK, 1.0, end)

    @property
    def mean_light(self) -> Floats:
        """Mean of each light curve, (n,) array."""
        owner = np.repeat(np.arange(len(self.parts)), self.parts)
        return np.bincount(owner, self.light_curve, len(self.parts)) / self.parts

    def light_at(self, star: NDArray[np.int64], time: Floats) -> Floats:
        """Relative brightness (m,) of stars (m,) at times (m,); a star that shines at an end also shines beyond it."""
        own = (time - self.start[star]) / self.length[star]
        part = np.clip((own * self.parts[star]).astype(np.int64), 0, self.parts[star] - 1)
        on = (time >= self.start[star]) | (self.start[star] <= 0)
        on &= (time <= self.end[star]) | (self.end[star] >= 1)
        return np.where(on, self.light_curve[self.first_part[star] + part], 0.0)


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
        self.own = OwnTimes.of(props, self.count) if "lit" in props else None
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
        own = FLOAT64(time)
        if self.own is not None:
            start, per_length = (dr.gather(FLOAT64, column, star) for column in self.own.on_device)
            own = (own - start) * per_length
        position = dr.clip(own, 0, 1) * (self.keyframes - 1)
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
    def light_share(self) -> Floats | None:
        """Mean light of each star over the shutter's time, relative to its magnitude, (n,) array; None if all are 1."""
        return None if self.own is None else self.own.length * self.own.mean_light

    @property
    def dark_at_ends(self) -> Any:
        """Whether stars are below the horizon when the shutter opens, and when it closes, (n, 2) bool array."""
        up = np.array(self.components[2]).reshape(self.count, -1)[:, [0, -1]]
        return up < self.lowest_sine

    def open_share(self, star: Any, first: Any, last: Any) -> Any:
        """Fraction of spans (m,) of the shutter's time, 0 to 1, in which the Moon does not hide the given stars (indices)."""
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
        """Optical depth (Spectrum) per airmass for paths (Float)."""
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
