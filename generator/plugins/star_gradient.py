"""A differentiable star pass: images of stars as functions of the camera's focal length, distortion and attitude.

The renderer adds splats in integers, through which no derivative passes. Here the camera's own projection, light falloff
and shutter run on a lens and an attitude whose numbers carry derivatives, and the same pixel-integrated Gaussian is added
in floating point. Tabulated point spread functions, light curves and geometry in front of the sky are left out.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.integrator import PSF_RADIUS_SIGMAS, NightSkyIntegrator
from generator.plugins.stars import StarEmitter

Floats = NDArray[np.float64]
COARSE_RADIUS_SIGMAS = 3.5
"""Radius at which a blurred stamp ends; a thousandth of its light is beyond."""
PARAMETERS = ("log focal length", "k1", "turn about x", "turn about y", "turn about z")
"""Parameters of an image: offsets of the logarithm of both focal lengths and of the lens model's k1, and a rotation of the
sky about the camera's axes after the scene's attitude, as a Gibbs vector times two (rad for small rotations)."""


@dataclass(frozen=True)
class StarImage:
    """Expected electrons of stars, and their derivatives.

    Attributes
    ----------
    electrons : (height, width) array
    derivatives : (k, height, width) array
        Derivatives with respect to `PARAMETERS`; k is 0 unless they are requested.
    """

    electrons: Floats
    derivatives: Floats


class DifferentiableStars:
    """The stars of a loaded scene as a function of its camera.

    Parameters
    ----------
    scene : Scene
        Scene with a ``skybench_camera`` of one channel and a lens model that has a k1, a ``skybench_integrator`` with a
        Gaussian, and the emitter ``stars``.

    Raises
    ------
    ValueError
        The scene contains one of the features left out here.
    """

    def __init__(self, scene: Any) -> None:
        self.camera: NightSkyCamera = scene.sensors()[0]
        integrator: NightSkyIntegrator = scene.integrator()
        self.emitter: StarEmitter = next(one for one in scene.emitters() if one.id() == "stars")
        if integrator.stamps is not None or self.emitter.own is not None or scene.shapes():
            raise ValueError("the differentiable star pass takes a Gaussian point spread, steady stars and an open sky")
        if not getattr(self.camera.precise_lens, "k", None):
            raise ValueError(
                f"the lens model {self.camera.projection.model} has no k1; take brown_conrady or kannala_brandt"
            )
        self.sigma_px = integrator.psf_sigma_px
        self.camera.film().prepare([])
        electrons = integrator.electrons_by_band(self.camera, self.emitter, 1)[:, :, 0]
        if electrons.shape[1] != 1:
            raise ValueError(f"the differentiable star pass takes one channel, not {electrons.shape[1]}")
        tracks = integrator.follow(scene, self.camera, self.emitter)
        # Moments are evenly spaced over the exposure, as many as the renderer uses for the fastest star.
        self.moments = int(np.bincount(tracks.star).max(initial=1))
        self.electrons = electrons[:, 0]

    def image(self, values: Floats, blur_px: float = 0.0, derivatives: bool = True) -> StarImage:
        """Render the stars.

        Parameters
        ----------
        values : (5,) array
            Values of `PARAMETERS`.
        blur_px : float
            Standard deviation of an additional Gaussian, which extends the reach of a derivative.
        derivatives : bool
            Compute the derivatives, by forward differentiation, one pass per parameter.
        """
        parameters = [FLOAT64(float(value)) for value in values]
        dr.make_opaque(parameters)
        columns = []
        for parameter in parameters if derivatives else ():
            dr.enable_grad(parameter)
            total = self._splat(parameters, blur_px)
            dr.forward(parameter)
            columns.append(self._host(dr.grad(total)))
            dr.disable_grad(parameter)
        electrons = self._host(self._splat(parameters, blur_px))
        return StarImage(electrons, np.stack(columns) if columns else np.zeros((0, *electrons.shape)))

    def _host(self, flat: Any) -> Floats:
        return np.array(flat, dtype=np.float64).reshape(self.camera.height, self.camera.width)

    @contextmanager
    def _changed(self, parameters: list[Any]) -> Iterator[NightSkyCamera]:
        """Yield the scene's camera with modified lens and attitude; they are restored when the block ends."""
        camera, (log_f, k1, *turn) = self.camera, parameters
        lens, quaternions = camera.precise_lens, camera.quaternions
        changed: Any = copy.copy(lens)
        changed.f_px, changed.fy_px = changed.f_px * dr.exp(log_f), changed.fy_px * dr.exp(log_f)
        changed.k = [changed.k[0] + k1, *changed.k[1:]]
        frame = dr.arange(mi.UInt32, camera.keyframes)
        x, y, z, w = (dr.gather(FLOAT64, quaternions, 4 * frame + component) for component in range(4))
        # Product of the rotation's quaternion, (turn/2, 1), with the attitude's; the camera normalises it.
        a, b, c = (0.5 * component for component in turn)
        product = (
            x + a * w + b * z - c * y,
            y + b * w + c * x - a * z,
            z + c * w + a * y - b * x,
            w - a * x - b * y - c * z,
        )
        turned = dr.zeros(FLOAT64, 4 * camera.keyframes)
        for component, value in enumerate(product):
            dr.scatter(turned, value, 4 * frame + component)
        camera.precise_lens, camera.quaternions = changed, turned
        try:
            yield camera
        finally:
            camera.precise_lens, camera.quaternions = lens, quaternions

    def _splat(self, parameters: list[Any], blur_px: float) -> Any:
        """Sum of all splats, FLOAT64 (height x width,)."""
        count = len(self.electrons)
        lane = dr.arange(mi.UInt32, count * self.moments)
        star = lane // self.moments
        share = (FLOAT64(lane % self.moments) + 0.5) / self.moments
        with self._changed(parameters) as camera:
            u, v, cosine, valid, time = camera.project_source(lambda time: self.emitter.direction(star, time), share)
            light = camera.relative_light(u, v, cosine) / self.moments
        above = self.emitter.direction(star, time)[2] >= 0
        light = dr.select(valid & above, light, 0) * dr.gather(FLOAT64, FLOAT64(self.electrons), star)
        sigma_px = math.hypot(self.sigma_px, blur_px)
        radius_px = math.ceil((COARSE_RADIUS_SIGMAS if blur_px else PSF_RADIUS_SIGMAS) * sigma_px + 0.5)
        reach = radius_px + 1
        near = valid & (u > -reach) & (v > -reach) & (u < camera.width + reach) & (v < camera.height + reach)
        kept = dr.compress(dr.detach(near & (light > 0)))
        u, v, light = (dr.gather(FLOAT64, value, kept) for value in (u, v, light))
        return self._add(u, v, light, sigma_px, radius_px)

    def _add(self, u: Any, v: Any, light: Any, sigma_px: float, radius_px: int) -> Any:
        """Spread light over pixels by a Gaussian integrated over each."""
        width, height = self.camera.width, self.camera.height
        side = 2 * radius_px + 1
        scale = dr.opaque(FLOAT64, 1 / (math.sqrt(2) * sigma_px))
        tap_lane = dr.arange(mi.UInt32, dr.width(u) * side)
        owner, tap = tap_lane // side, tap_lane % side
        shares = []
        for position in (u, v):
            centre = dr.gather(FLOAT64, position, owner)
            distance = dr.detach(dr.round(centre)) - centre + FLOAT64(mi.Int32(tap) - radius_px)
            shares.append(0.5 * (dr.erf((distance + 0.5) * scale) - dr.erf((distance - 0.5) * scale)))
        dr.eval(shares)
        lane = dr.arange(mi.UInt32, dr.width(u) * side * side)
        owner, offset = lane // (side * side), lane % (side * side)
        across = dr.gather(FLOAT64, shares[0], owner * side + offset % side)
        down = dr.gather(FLOAT64, shares[1], owner * side + offset // side)
        columns, rows = (mi.Int32(dr.round(dr.detach(position))) for position in (u, v))
        column = dr.gather(mi.Int32, columns, owner) + mi.Int32(offset % side) - radius_px
        row = dr.gather(mi.Int32, rows, owner) + mi.Int32(offset // side) - radius_px
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        total = dr.zeros(FLOAT64, width * height)
        amount = dr.gather(FLOAT64, light, owner) * across * down
        dr.scatter_add(total, amount, mi.UInt32(row * width + column), inside)
        return total
