"""``skybench_camera``: a sensor that counts electrons.

The weight of a ray is aperture area x projected pupil x exposure x solid angle of the pixel x spectral range, in m^2 s sr
nm, times the film's response. As for Mitsuba's own sensors, a ``specfilm`` divides by its overall response before it
weights with each channel's. If the film's channels contain quantum efficiencies, photon radiance (photons s^-1 m^-2 nm^-1
sr^-1) thus becomes expected electrons per pixel.

======================  ==========  =========================================================================
parameter               type        meaning
======================  ==========  =========================================================================
``model``               string      a name of :data:`generator.scenario.projection.MODELS` (default ``pinhole``)
``f_px``, ``fy_px``     float       focal length along u and v, px
``cx_px``, ``cy_px``    float       principal point, px
``k1`` … ``k6``         float       radial distortion (default 0)
``p1``, ``p2``          float       decentring (default 0)
``s1`` … ``s4``         float       thin prism (default 0)
``tau_x``, ``tau_y``    float       tilt of the sensor, rad (default 0)
``image_circle_px``     float       radius around the principal point beyond which no light falls
``pupil``               string      ``cosine`` (default) or ``constant``: projected area of the pupil off axis
``vignetting``          tensor      (n,): a1, a2, … of the factor 1 + a1 q + a2 q^2 + …
``corner_px``           float       where q, the squared distance from the principal point, is 1 (with vignetting)
``aperture_area_m2``    float       area of the entrance pupil, m^2
``exposure_s``          float       exposure of each row, s
``read_out_s``          float       time between the exposures' starts of the first and the last row, s (default 0)
``reads_up``            boolean     whether the last row is the first to be exposed (default false)
``attitude``            tensor      (k, 3, 3): R_cam, ENU to camera, evenly spaced over the shutter's time, k >= 1
``film``                plugin      a ``specfilm``
======================  ==========  =========================================================================

The world frame of the scene is east, north, up. Time runs from 0 to 1 over the shutter's time, from the start of the
first row's exposure to the end of the last row's. With a global shutter these are the exposure's start and end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from generator.plugins.lens import Lens, make_lens
from generator.plugins.scene_tensors import array
from generator.plugins.spectra import SPECTRAL_RANGE_NM, stratified_wavelengths
from generator.scenario.projection import COEFFICIENTS, MODELS, Projection

FLOAT64: Any = dr.float64_array_t(mi.Float)
NEGLIGIBLE = 1e-20
"""Size of a negligible component of a unit vector."""
ROW_ITERATIONS = 4
"""Iterations of the fixed point; each reduces the error by a factor of the image's motion in rows per line time."""


def _rotation(quaternion: list[Any]) -> list[list[Any]]:
    """Rotation of a quaternion (x, y, z, w) of any length, as rows of components."""
    x, y, z, w = quaternion
    scale = 2 / (x * x + y * y + z * z + w * w)
    return [
        [1 - scale * (y * y + z * z), scale * (x * y - z * w), scale * (x * z + y * w)],
        [scale * (x * y + z * w), 1 - scale * (x * x + z * z), scale * (y * z - x * w)],
        [scale * (x * z - y * w), scale * (y * z + x * w), 1 - scale * (x * x + y * y)],
    ]


def _single(component: Any) -> Any:
    """Convert a component (Float64) of a rotation to single precision; tiny numbers, which are slow, become zero."""
    return dr.select(dr.abs(component) < NEGLIGIBLE, 0, mi.Float(component))


@dataclass(frozen=True)
class FilmPoints:
    """Places on lines of the film. All places on a line are exposed at the same time, so its rotation is computed only once.

    Attributes
    ----------
    position : Point2f
        Places, 0 to 1 over the frame.
    line : UInt32
        Line of each place.
    line_y : Float
        `position.y` of each line.
    """

    position: Any
    line: Any
    line_y: Any

    @classmethod
    def middles(cls, width: int, height: int) -> FilmPoints:
        """Centres of all pixels of a frame, row by row."""
        pixel = dr.arange(mi.UInt32, width * height)
        size = mi.ScalarVector2f(width, height)
        position = mi.Point2f(mi.Float(pixel % width) + 0.5, mi.Float(pixel // width) + 0.5) / size
        rows = mi.Float(dr.arange(mi.UInt32, height)) + 0.5
        return cls(position, pixel // width, (mi.Point2f(rows, rows) / size).y)

    def of(self, chosen: Any) -> FilmPoints:
        """Return the points at some indices (UInt32)."""
        return replace(
            self,
            position=dr.gather(mi.Point2f, self.position, chosen),
            line=dr.gather(mi.UInt32, self.line, chosen),
        )

    def moved(self, offset: Any) -> FilmPoints:
        """Return all points, moved by an offset (Vector2f) on the film."""
        return replace(self, position=self.position + offset, line_y=self.line_y + offset.y)


class NightSkyCamera(mi.Sensor):
    """See the module's description."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        model = props.get("model", "pinhole")
        if model not in MODELS:
            raise ValueError(f"skybench_camera: model '{model}' is not one of: {', '.join(MODELS)}")

        def numbers(*names: str) -> tuple[float, ...]:
            return tuple(float(props.get(name, 0.0)) for name in names)

        projection = Projection(
            model,
            *(float(props[name]) for name in ("f_px", "fy_px", "cx_px", "cy_px")),
            k=numbers(*(f"k{i + 1}" for i in range(COEFFICIENTS.get(model, 0)))),
            p=numbers("p1", "p2"),
            s=numbers("s1", "s2", "s3", "s4"),
            tilt_rad=numbers("tau_x", "tau_y"),
        )
        self.projection = projection
        self.lens: Lens = make_lens(projection, lambda value: dr.opaque(mi.Float, value))
        self.precise_lens: Lens = make_lens(projection, lambda value: dr.opaque(FLOAT64, value))
        self.image_circle_px = float(props.get("image_circle_px", math.inf))
        self.pupil_law = props.get("pupil", "cosine")
        if self.pupil_law not in ("cosine", "constant"):
            raise ValueError(f"skybench_camera: pupil '{self.pupil_law}' is not one of: cosine, constant")
        self.vignetting = array(props["vignetting"], 1).tolist() if "vignetting" in props else []
        self.corner_px = float(props.get("corner_px", 1.0))
        exposure_s, read_out_s = float(props["exposure_s"]), float(props.get("read_out_s", 0.0))
        self.exposure_share = exposure_s / (exposure_s + read_out_s)
        self.read_out_share = read_out_s / (exposure_s + read_out_s)
        self.reads_up = bool(props.get("reads_up", False))
        self.collected = dr.opaque(mi.Float, float(props["aperture_area_m2"]) * exposure_s)
        matrices = array(props["attitude"], 3)
        if matrices.ndim != 3 or matrices.shape[1:] != (3, 3):
            raise ValueError(f"skybench_camera: attitude must have shape (k, 3, 3), not {matrices.shape}")
        quaternions = Rotation.from_matrix(matrices).as_quat()
        for row in range(1, len(quaternions)):
            if quaternions[row] @ quaternions[row - 1] < 0:
                quaternions[row] *= -1
        self.keyframes = len(quaternions)
        towards_middle = np.abs(quaternions @ quaternions[len(quaternions) // 2])
        self.swept_rad = 4 * math.acos(min(float(towards_middle.min()), 1.0))
        self.pixel_rad = 1 / min(projection.f_px, projection.fy_px)
        self.quaternions = FLOAT64(quaternions.ravel())
        self.width, self.height = (int(size) for size in self.film().size())
        self.response = self.film().sensor_response_function()

    def world_to_camera(self, time: Any) -> list[list[Any]]:
        """Rotation ENU to camera at `time` (0 to 1; double precision), as rows of components.

        Between keyframes the quaternions are interpolated linearly and normalised, which differs from uniform rotation by
        less than a hundred-thousandth of the step for steps under 5 degrees.
        """
        if self.keyframes == 1:
            rotation = _rotation([dr.gather(FLOAT64, self.quaternions, mi.UInt32(k)) for k in range(4)])
            # The same for every lane, so computed once.
            dr.eval(rotation)
            return rotation
        position = dr.clip(FLOAT64(time), 0, 1) * (self.keyframes - 1)
        lower = dr.minimum(mi.UInt32(position), self.keyframes - 2)
        weight = position - FLOAT64(lower)
        return _rotation(
            [
                dr.lerp(
                    dr.gather(FLOAT64, self.quaternions, 4 * lower + k),
                    dr.gather(FLOAT64, self.quaternions, 4 * lower + (4 + k)),
                    weight,
                )
                for k in range(4)
            ]
        )

    def moment(self, v: Any, share: Any) -> Any:
        """Time at which the fraction `share` (0 to 1) of the exposure of row `v` (px) has passed; both Float64."""
        if self.read_out_share == 0:
            return FLOAT64(share)
        row = self.height - 1 - v if self.reads_up else v
        step = dr.opaque(FLOAT64, self.read_out_share / max(self.height - 1, 1))
        return row * step + share * dr.opaque(FLOAT64, self.exposure_share)

    def project_source(self, direction: Any, share: Any) -> tuple[Any, Any, Any, Any, Any]:
        """Place of a moving source on the film when the fraction `share` of the exposure of its row has passed.

        The time follows from the row and the row from the time. This fixed-point iteration contracts if the image moves
        by less than one row per line time.

        Parameters
        ----------
        direction : callable
            Returns the source's unit vector (east, north, up; Float64) at a time.
        share : Float64
            0 to 1.

        Returns
        -------
        u, v, cosine, valid
            As for :meth:`project`.
        time : Float64
        """
        time = self.moment(FLOAT64(0.5 * (self.height - 1)), share)
        u, v, cosine, valid = self._project(direction(time), time)
        if self.read_out_share:
            for _ in range(ROW_ITERATIONS):
                time = self.moment(dr.clip(dr.select(valid, v, 0), -self.height, 2 * self.height), share)
                u, v, cosine, valid = self._project(direction(time), time)
        return u, v, cosine, valid, time

    def project(self, east: Any, north: Any, up: Any, time: Any) -> tuple[Any, Any, Any, Any]:
        """Places of directions on the film.

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
            Whether the direction is in the lens model's range.
        """
        rows = self.world_to_camera(time)
        x, y, z = (row[0] * east + row[1] * north + row[2] * up for row in rows)
        u, v, valid = self.precise_lens.project(x, y, z)
        return u, v, z, valid

    def _project(self, direction: tuple[Any, Any, Any], time: Any) -> tuple[Any, Any, Any, Any]:
        east, north, up = direction
        return self.project(east, north, up, time)

    def relative_light(self, u: Any, v: Any, cosine: Any) -> Any:
        """Light through the lens at a film position relative to the axis, per solid angle: pupil, vignetting, image circle.

        It works in the precision of its arguments; `cosine` is that of the angle from the boresight.
        """
        light = dr.maximum(cosine, 0) if self.pupil_law == "cosine" else cosine * 0 + 1
        square = dr.square(u - self.projection.cx_px) + dr.square(v - self.projection.cy_px)
        if self.vignetting:
            q = square / self.corner_px**2
            factor = q * 0
            for coefficient in reversed(self.vignetting):
                factor = (factor + coefficient) * q
            light *= dr.maximum(1 + factor, 0)
        if math.isfinite(self.image_circle_px):
            light = dr.select(square <= self.image_circle_px**2, light, 0)
        return light

    def spectral_weight(self, wavelengths: Any) -> Any:
        """Spectral range times the film's overall response, nm (Spectrum), at uniformly drawn wavelengths."""
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(wavelengths))
        si.wavelengths = wavelengths
        return self.response.eval(si) * SPECTRAL_RANGE_NM

    def sample_ray(
        self, time: Any, wavelength_sample: Any, position_sample: Any, aperture_sample: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """Mitsuba's interface: a ray through a film position (0 to 1 over the frame) and its weight."""
        del aperture_sample, active
        ray, etendue = self.pixel_ray(time, position_sample)
        ray.wavelengths = stratified_wavelengths(wavelength_sample)
        return ray, etendue * self.spectral_weight(ray.wavelengths)

    def pixel_ray(self, share: Any, position_sample: Any) -> tuple[Any, Any]:
        """Ray through a film position (0 to 1 over the frame) at a fraction of its row's exposure, without wavelengths.

        Returns
        -------
        ray : Ray3f
        etendue : Float
            Aperture area x projected pupil x vignetting x exposure x solid angle of a pixel, m^2 s sr; 0 outside the lens'
            range.
        """
        u = position_sample.x * self.width - 0.5
        v = position_sample.y * self.height - 0.5
        time = self.moment(FLOAT64(v), FLOAT64(share))
        rows = [[_single(component) for component in row] for row in self.world_to_camera(time)]
        return self._ray(u, v, rows, mi.Float(time))

    def line_ray(self, share: Any, points: FilmPoints) -> tuple[Any, Any]:
        """Rays of :meth:`pixel_ray`, identical to the bit, for places on lines; faster while the camera turns."""
        if self.keyframes == 1:
            return self.pixel_ray(share, points.position)
        time = self.moment(FLOAT64(points.line_y * self.height - 0.5), FLOAT64(share))
        numbers = [_single(component) for row in self.world_to_camera(time) for component in row] + [mi.Float(time)]
        if self.read_out_share == 0:
            # All lines are exposed at the same time.
            dr.eval(numbers)
        else:
            # Packets of four numbers per line.
            numbers += [mi.Float(0)] * (-len(numbers) % 4)
            tables = [dr.ravel(mi.Vector4f(*numbers[first : first + 4])) for first in range(0, len(numbers), 4)]
            dr.eval(tables)
            numbers = [value for table in tables for value in dr.gather(mi.Vector4f, table, points.line)]
        u, v = points.position.x * self.width - 0.5, points.position.y * self.height - 0.5
        return self._ray(u, v, [numbers[0:3], numbers[3:6], numbers[6:9]], numbers[9])

    def _ray(self, u: Any, v: Any, rows: list[list[Any]], time: Any) -> tuple[Any, Any]:
        """Ray and etendue for places, px, with rows of rotations."""
        x, y, z, valid = self.lens.unproject(u, v)
        direction = mi.Vector3f(*(rows[0][k] * x + rows[1][k] * y + rows[2][k] * z for k in range(3)))
        etendue = self.collected * self.relative_light(u, v, z) * self.lens.solid_angle(x, y, z)
        ray = mi.Ray3f(mi.Point3f(0), direction / dr.norm(direction), time, mi.Spectrum(0))
        return ray, dr.select(valid, etendue, 0)

    def sample_ray_differential(
        self, time: Any, wavelength_sample: Any, position_sample: Any, aperture_sample: Any, active: Any = True
    ) -> tuple[Any, Any]:
        """Mitsuba's interface: as :meth:`sample_ray`; differentials are zero because no texture of the sky is filtered."""
        ray, weight = self.sample_ray(time, wavelength_sample, position_sample, aperture_sample, active)
        return mi.RayDifferential3f(ray), weight

    def to_string(self) -> str:
        """Return a short description."""
        return f"NightSkyCamera[{self.width} x {self.height}, {self.keyframes} attitudes]"
