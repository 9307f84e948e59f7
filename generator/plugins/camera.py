"""``skybench_camera``: a sensor that counts electrons.

The weight of a ray is aperture area x projected pupil x exposure x solid angle of the pixel x spectral range, in m^2 s sr
nm, times the film's response, as Mitsuba's own sensors have it: a ``specfilm`` divides by its overall response before it
weights with each channel's. Photon radiance (photons s^-1 m^-2 nm^-1 sr^-1) thus becomes expected electrons per pixel,
when the film's channels hold quantum efficiencies.

=====================  ==========  ==========================================================================
parameter              type        meaning
=====================  ==========  ==========================================================================
``model``              string      ``pinhole``
``f_px``, ``fy_px``    float       focal length along u and v, px
``cx_px``, ``cy_px``   float       principal point, px
``aperture_area_m2``   float       area of the entrance pupil, m^2
``exposure_s``         float       s
``attitude``           tensor      (k, 3, 3): R_cam, ENU to camera, evenly spaced over the exposure, k >= 1
``film``               plugin      a ``specfilm``
=====================  ==========  ==========================================================================

The world frame of the scene is east, north, up. Ray time runs from 0 (exposure start) to 1 (its end).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from generator.plugins.lens import Lens, Pinhole
from generator.plugins.spectra import SPECTRAL_RANGE_NM, stratified_wavelengths

FLOAT64: Any = dr.float64_array_t(mi.Float)


class NightSkyCamera(mi.Sensor):
    """See the module's description."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        model = props.get("model", "pinhole")
        if model != "pinhole":
            raise ValueError(f"skybench_camera: model '{model}' is not one of: pinhole")
        intrinsics = [float(props[name]) for name in ("f_px", "fy_px", "cx_px", "cy_px")]
        self.lens: Lens = Pinhole(*(dr.opaque(mi.Float, value) for value in intrinsics))
        self.precise_lens: Lens = Pinhole(*(dr.opaque(FLOAT64, value) for value in intrinsics))
        self.collected = dr.opaque(mi.Float, float(props["aperture_area_m2"]) * float(props["exposure_s"]))
        matrices = np.array(props["attitude"], dtype=np.float64)
        if matrices.ndim != 3 or matrices.shape[1:] != (3, 3):
            raise ValueError(f"skybench_camera: attitude must have shape (k, 3, 3), not {matrices.shape}")
        quaternions = Rotation.from_matrix(matrices).as_quat()
        for row in range(1, len(quaternions)):
            if quaternions[row] @ quaternions[row - 1] < 0:
                quaternions[row] *= -1
        self.keyframes = len(quaternions)
        self.quaternions = FLOAT64(quaternions.ravel())
        self.width, self.height = (int(size) for size in self.film().size())
        self.response = self.film().sensor_response_function()

    def world_to_camera(self, time: Any) -> list[list[Any]]:
        """Rotation ENU to camera at `time` (0 to 1; double precision), as rows of components.

        Between keyframes the quaternions are blended linearly and normalised, which differs from uniform rotation by less
        than a hundred-thousandth of the step for steps under 5 degrees.
        """
        position = dr.clip(FLOAT64(time), 0, 1) * (self.keyframes - 1)
        lower = dr.minimum(mi.UInt32(position), max(self.keyframes - 2, 0))
        upper = dr.minimum(lower + 1, self.keyframes - 1)
        weight = position - FLOAT64(lower)
        x, y, z, w = (
            dr.lerp(
                dr.gather(FLOAT64, self.quaternions, 4 * lower + k),
                dr.gather(FLOAT64, self.quaternions, 4 * upper + k),
                weight,
            )
            for k in range(4)
        )
        scale = 2 / (x * x + y * y + z * z + w * w)
        return [
            [1 - scale * (y * y + z * z), scale * (x * y - z * w), scale * (x * z + y * w)],
            [scale * (x * y + z * w), 1 - scale * (x * x + z * z), scale * (y * z - x * w)],
            [scale * (x * z - y * w), scale * (y * z + x * w), 1 - scale * (x * x + y * y)],
        ]

    def project(self, east: Any, north: Any, up: Any, time: Any) -> tuple[Any, Any, Any, Any]:
        """Where directions fall on the film.

        Parameters
        ----------
        east, north, up : Float64
            Components of unit vectors.
        time : Float64
            0 (exposure start) to 1 (end).

        Returns
        -------
        u, v : Float64
            Pixel position, px.
        cosine : Float64
            Cosine of the angle from the boresight.
        valid : Mask
            Whether the direction lies in the lens model's range.
        """
        rows = self.world_to_camera(time)
        x, y, z = (row[0] * east + row[1] * north + row[2] * up for row in rows)
        u, v, valid = self.precise_lens.project(x, y, z)
        return u, v, z, valid

    def spectral_weight(self, wavelengths: Any) -> Any:
        """Spectral range times the film's overall response, nm (Spectrum), at uniformly drawn wavelengths."""
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wavelengths))
        si.wavelengths = wavelengths
        return self.response.eval(si) * SPECTRAL_RANGE_NM

    def star_weight(self, wavelengths: Any) -> Any:
        """Aperture area x exposure x spectral weight, m^2 s nm (Spectrum), for a point source on the boresight."""
        return self.collected * self.spectral_weight(wavelengths)

    def sample_ray(
        self, time: Any, wavelength_sample: Any, position_sample: Any, aperture_sample: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """Mitsuba's interface: a ray through a film position (0 to 1 over the frame) and its weight."""
        del aperture_sample, active
        u = position_sample.x * self.width - 0.5
        v = position_sample.y * self.height - 0.5
        x, y, z = self.lens.unproject(u, v)
        rows = self.world_to_camera(time)
        direction = mi.Vector3f(
            *(mi.Float(rows[0][k]) * x + mi.Float(rows[1][k]) * y + mi.Float(rows[2][k]) * z for k in range(3))
        )
        wavelengths = stratified_wavelengths(wavelength_sample)
        ray = mi.Ray3f(mi.Point3f(0), dr.normalize(direction), mi.Float(time), wavelengths)
        etendue = self.collected * self.lens.pupil(z) * self.lens.solid_angle(u, v)
        return ray, etendue * self.spectral_weight(wavelengths)

    def sample_ray_differential(
        self, time: Any, wavelength_sample: Any, position_sample: Any, aperture_sample: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """As :meth:`sample_ray`; differentials are zero because nothing in the sky is a filtered texture."""
        ray, weight = self.sample_ray(time, wavelength_sample, position_sample, aperture_sample, active)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """Return a short description."""
        return f"NightSkyCamera[{self.width} x {self.height}, {self.keyframes} attitudes]"
