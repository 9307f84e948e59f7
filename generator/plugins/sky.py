"""``skybench_sky``: the diffuse night sky as an environment emitter.

Radiance is a sum of (direction map) x (spectrum). The meaning of maps and spectra is defined in :mod:`generator.sky`.

======================  =======  ==================================================================================
parameter               type     meaning
======================  =======  ==================================================================================
``maps``                tensor   (1, k, ny, nx): rows by altitude as in :mod:`generator.sky.directions`, columns by azimuth
``spectra``             tensor   (1, k, n): spectra on the generator's wavelength grid
``veiled_maps``         tensor   (1, veils * k, ny, nx): further maps of the same spectra behind veils of cloud (optional)
``moon``                tensor   from :func:`generator.plugins.clouds.moon_numbers`: the last veil is that of moonlight;
                                 likewise ``moon_angles`` and ``moon_more`` (optional)
``low_maps``            tensor   (1, k, m, nx): maps below the horizontal, rows evenly from the horizon up to 0 (optional)
``lowest_deg``          float    apparent altitude of the horizon of ``low_maps``
``cloud_coarse``        tensor   tile of the cloud's field; likewise ``cloud_fine``
``cloud_numbers``       tensor   from :func:`generator.plugins.clouds.cloud_numbers`
======================  =======  ==================================================================================

Map times spectrum is radiance in photons s^-1 m^-2 nm^-1 sr^-1 at the ground. The scene's z axis is up; the sky is black
below the horizon, which without ``low_maps`` is the horizontal.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned_zeros
from generator.plugins.clouds import CloudTexture, MoonTexture
from generator.plugins.scene_tensors import array
from generator.plugins.spectra import SpectralTable, stratified_wavelengths
from generator.sky.directions import ALTITUDE_POWER

PACKET = 4
"""Maps read at once."""
DISTANCE = 1e6
"""Distance of the sky for shadow rays, scene units."""

UNIFORM_HEMISPHERE_DENSITY = 0.5 / math.pi


class DiffuseSkyEmitter(mi.Emitter):
    """See the module's description."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.m_flags = int(mi.EmitterFlags.Infinite) | int(mi.EmitterFlags.SpatiallyVarying)
        spectra, maps = mi.TensorXf(props["spectra"]), array(props["maps"], 3, np.float32)
        self.spectra = SpectralTable(mi.TensorXf(spectra.array, spectra.shape[-2:]))
        if maps.ndim != 3 or len(maps) != self.spectra.rows or min(maps.shape) < 1 or maps.shape[1] < 2:
            raise ValueError(f"skybench_sky: maps must have shape ({self.spectra.rows}, ny, nx), not {maps.shape}")
        self.count, self.rows, self.columns = maps.shape
        self.stride = 1 if self.count == 1 else -(-self.count // PACKET) * PACKET
        self.values = self._texture(maps)
        self.lowest_sine = 0.0
        if "low_maps" in props:
            low = np.array(props["low_maps"], dtype=np.float32)
            low = low.reshape(-1, *low.shape[-2:])
            if len(low) != self.count or low.shape[2] != self.columns or low.shape[1] < 2:
                raise ValueError(
                    f"skybench_sky: low_maps must have shape ({self.count}, m, {self.columns}), not {low.shape}"
                )
            self.low_rows, self.low_values = low.shape[1], self._texture(low)
            self.lowest_rad = math.radians(float(props["lowest_deg"]))
            self.lowest_sine = math.sin(self.lowest_rad)
        self.veiled: list[Any] = []
        self.moon: MoonTexture | None = None
        if "veiled_maps" in props:
            behind = np.array(props["veiled_maps"], dtype=np.float32).reshape(-1, *maps.shape)
            self.clouds = CloudTexture(props["cloud_coarse"], props["cloud_fine"], props["cloud_numbers"])
            self.veiled = [self._texture(part) for part in behind]
            if "moon" in props:
                self.moon = MoonTexture(props["moon"], props["moon_angles"], props["moon_more"])

    def is_environment(self) -> bool:
        """Mitsuba's interface: rays that leave the scene end here."""
        return True

    def set_scene(self, scene: Any) -> None:
        """Mitsuba's interface: the sky is infinitely far away, whatever the scene's size."""
        del scene

    def _texture(self, maps: NDArray[np.float32]) -> Any:
        """Maps (k, ny, nx) as a Float.

        It has an additional column, so that the texture wraps in azimuth without a seam. Terms vary fastest, so that a
        look-up reads neighbours in memory.
        """
        texels = aligned_zeros((maps.shape[1], self.columns + 1, self.stride), np.float32)
        texels[:, :-1, : self.count] = np.moveaxis(maps, 0, -1)
        texels[:, -1] = texels[:, 0]
        return mi.Float(texels.ravel())

    def _between(self, values: Any, place: tuple[Any, Any], share: tuple[Any, Any]) -> list[Any]:
        """Values of all maps between the texel at a row and column (UInt32) and the next ones, with weights for these."""
        first = place[0] * (self.columns + 1) + place[1]
        corners = []
        for texel in (first, first + 1, first + (self.columns + 1), first + (self.columns + 2)):
            if self.count == 1:
                corners.append([dr.gather(mi.Float, values, texel)])
                continue
            packets = self.stride // PACKET
            read = [dr.gather(mi.Vector4f, values, texel * packets + part) for part in range(packets)]
            corners.append([value for packet in read for value in packet][: self.count])
        down, right = share
        return [dr.lerp(dr.lerp(a, b, right), dr.lerp(c, d, right), down) for a, b, c, d in zip(*corners, strict=True)]

    def coefficients(self, direction: Any, aureole: bool = True) -> list[Any]:
        """Value of every map along unit vectors `direction` (Vector3f, ENU), one Float each; zero below the horizon.

        Without `aureole`, the Moon's aureole in cloud is left out, for directions that are further apart than its width.
        """
        up = direction.z >= 0
        altitude = dr.asin(dr.clip(direction.z, 0, 1)) * (2 / math.pi)
        row = dr.power(altitude, 1 / ALTITUDE_POWER) * (self.rows - 1)
        turn = dr.atan2(direction.x, direction.y) * (0.5 / math.pi)
        column = (turn - dr.floor(turn)) * self.columns
        r0 = dr.minimum(mi.UInt32(row), self.rows - 2)
        c0 = dr.minimum(mi.UInt32(column), self.columns - 1)
        wr, wc = row - mi.Float(r0), column - mi.Float(c0)
        result = self._between(self.values, (r0, c0), (wr, wc))
        if self.veiled:
            depths = self.clouds.slant_depths(direction)
            factors = [self.clouds.transmission(depths)]
            if self.moon is not None:
                factors.append(self.moon.radiance(self.clouds, depths, direction, aureole))
            for factor, values in zip(factors, self.veiled, strict=True):
                behind = self._between(values, (r0, c0), (wr, wc))
                result = [dr.fma(factor, light, value) for light, value in zip(behind, result, strict=True)]
        if self.lowest_sine < 0:
            below = self._low_coefficients(direction, column)
            return [dr.select(up, value, low) for value, low in zip(result, below, strict=True)]
        return [dr.select(up, value, 0) for value in result]

    def _low_coefficients(self, direction: Any, column: Any) -> list[Any]:
        """Coefficients between the horizon and the horizontal, at fractional columns; zero below the horizon."""
        altitude = dr.asin(dr.clip(direction.z, -1, 0))
        row = dr.clip(1 - altitude / self.lowest_rad, 0, 1) * (self.low_rows - 1)
        r0 = dr.minimum(mi.UInt32(row), self.low_rows - 2)
        c0 = dr.minimum(mi.UInt32(column), self.columns - 1)
        wr, wc = row - mi.Float(r0), column - mi.Float(c0)
        seen = direction.z >= self.lowest_sine
        return [dr.select(seen, light, 0) for light in self._between(self.low_values, (r0, c0), (wr, wc))]

    def radiance(self, direction: Any, wavelengths: Any) -> Any:
        """Radiance (Spectrum) that arrives from unit vectors `direction` (Vector3f, ENU)."""
        total = mi.Spectrum(0)
        for k, coefficient in enumerate(self.coefficients(direction)):
            total += coefficient * self.spectra.eval(mi.Float(k), wavelengths)
        return dr.maximum(total, 0)

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
        return f"DiffuseSkyEmitter[{self.count} terms, {self.rows} x {self.columns}]"
