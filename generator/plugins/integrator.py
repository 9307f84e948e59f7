"""``skybench_integrator``: expected electrons of a night-sky scene, without Monte Carlo noise.

The diffuse sky is taken by one camera ray per pixel through its centre, for stratified wavelengths over the whole range;
geometry in front of it is a dark silhouette. Stars are projected by the same sensor, at several moments of the exposure,
and spread over pixels by the point spread function, integrated over each pixel.

Splats add up in 64-bit integers: integer addition does not depend on order, so the image has the same bits on any number
of threads.

======================  =======  =================================================================================
parameter               type     meaning
======================  =======  =================================================================================
``psf_sigma_px``        float    standard deviation of the Gaussian point spread function, px
``wavelength_groups``   int      wavelengths per pixel over four (default 33: one every 4.9 nm)
``largest_step_px``     float    longest step of a star between two moments of the exposure (default 0.2 px)
======================  =======  =================================================================================
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.spectra import stratified_wavelengths
from generator.plugins.stars import StarEmitter

UINT64: Any = dr.uint64_array_t(mi.Float)
PSF_RADIUS_SIGMAS = 6.0
UNITS_PER_ELECTRON = 2.0**24
"""Resolution of the splats' fixed-point sum: 6e-8 electrons, with room for 1e12 electrons in a pixel."""


class NightSkyIntegrator(mi.SamplingIntegrator):
    """See the module's description."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.psf_sigma_px = float(props["psf_sigma_px"])
        self.wavelength_groups = int(props.get("wavelength_groups", 33))
        self.largest_step_px = float(props.get("largest_step_px", 0.2))
        self.radius_px = math.ceil(PSF_RADIUS_SIGMAS * self.psf_sigma_px + 0.5)

    def render(
        self,
        scene: Any,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> Any:
        """Mitsuba's interface; `seed` and `spp` have no meaning here, because nothing is sampled at random.

        Returns
        -------
        TensorXf
            (height, width, channels): expected electrons per pixel.
        """
        del seed, spp, develop
        camera = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        if not isinstance(camera, NightSkyCamera):
            raise TypeError("skybench_integrator needs a skybench_camera")
        camera.film().prepare([])
        image = self.diffuse(scene, camera)
        for emitter in scene.emitters():
            if isinstance(emitter, StarEmitter) and emitter.count:
                image += self.stars(scene, camera, emitter)
        if evaluate:
            dr.eval(image)
        return image

    def diffuse(self, scene: Any, camera: NightSkyCamera) -> Any:
        """Expected electrons from the diffuse sky, TensorXf (height, width, channels)."""
        film = camera.film()
        width, height = camera.width, camera.height
        channels = film.create_block().channel_count() - 1
        environment = scene.environment()
        if environment is None:
            return dr.zeros(mi.TensorXf, (height, width, channels))
        pixel = dr.arange(mi.UInt32, width * height)
        position = mi.Point2f(mi.Float(pixel % width) + 0.5, mi.Float(pixel // width) + 0.5)
        film_position = position / mi.ScalarVector2f(width, height)
        middle = mi.Float(0.5)
        ray, weight = camera.sample_ray(middle, mi.Float(0.5), film_position, mi.Point2f(0.5))
        # The weight is one number per pixel times the spectral response; that number times the sum over the sky's terms of
        # (value here) x (spectrum integrated over the response) is the pixel's light.
        per_pixel = weight[0] / camera.spectral_weight(ray.wavelengths)[0]
        terms = self.term_electrons(camera, environment, channels)
        values = environment.coefficients(ray.d)
        total = []
        for channel in range(channels):
            light = dr.zeros(mi.Float, width * height)
            for term, value in enumerate(values):
                light = dr.fma(value, dr.gather(mi.Float, terms[channel], mi.UInt32(term)), light)
            total.append(dr.maximum(light, 0) * per_pixel)
        if scene.shapes():
            ray, _ = camera.sample_ray(middle, mi.Float(0.5), film_position, mi.Point2f(0.5))
            covered = scene.ray_test(ray)
            total = [dr.select(covered, 0, channel) for channel in total]
        image = dr.zeros(mi.Float, width * height * channels)
        for channel, value in enumerate(total):
            dr.scatter(image, value, pixel * channels + channel)
        return mi.TensorXf(image, (height, width, channels))

    def term_electrons(self, camera: NightSkyCamera, environment: Any, channels: int) -> list[Any]:
        """Spectrum of each term of the sky integrated over the film's response, a Float (terms) per channel."""
        film = camera.film()
        term = mi.Float(dr.arange(mi.UInt32, environment.count))
        total = [dr.zeros(mi.Float, environment.count) for _ in range(channels)]
        for group in range(self.wavelength_groups):
            wavelengths = stratified_wavelengths(dr.full(mi.Float, (group + 0.5) / (4 * self.wavelength_groups), 1))
            spectrum = environment.spectra.eval(term, wavelengths) * camera.spectral_weight(wavelengths)
            values = film.prepare_sample(spectrum, wavelengths, channels + 1)
            total = [so_far + value for so_far, value in zip(total, values, strict=False)]
        total = [channel / self.wavelength_groups for channel in total]
        dr.eval(total)
        return total

    def star_electrons(self, camera: NightSkyCamera, emitter: StarEmitter) -> list[Any]:
        """Expected electrons of each star on the boresight, over the whole point spread function, a Float per channel."""
        film = camera.film()
        channels = film.create_block().channel_count() - 1
        star = dr.arange(mi.UInt32, emitter.count)
        total = [dr.zeros(mi.Float, emitter.count) for _ in range(channels)]
        for group in range(self.wavelength_groups):
            sample = (group + 0.5) / (4 * self.wavelength_groups)
            wavelengths = stratified_wavelengths(sample)
            electrons = emitter.irradiance(star, wavelengths) * camera.star_weight(wavelengths)
            values = film.prepare_sample(electrons, wavelengths, channels + 1)
            total = [so_far + value for so_far, value in zip(total, values, strict=False)]
        total = [channel / self.wavelength_groups for channel in total]
        dr.eval(total)
        return total

    def moments(self, camera: NightSkyCamera, emitter: StarEmitter) -> int:
        """How many moments of the exposure it takes so that no star steps further than ``largest_step_px``."""
        star = dr.arange(mi.UInt32, emitter.count)
        checks = max(2, camera.keyframes)
        longest = 0.0
        for check in range(checks - 1):
            start, stop = check / (checks - 1), (check + 1) / (checks - 1)
            u0, v0, _, valid0 = camera.project(*emitter.direction(star, start), FLOAT64(start))
            u1, v1, _, valid1 = camera.project(*emitter.direction(star, stop), FLOAT64(stop))
            near = valid0 & valid1 & self._in_reach(camera, u0, v0)
            step = dr.select(near, dr.sqrt(dr.square(u1 - u0) + dr.square(v1 - v0)), 0)
            longest += float(np.max(step.numpy(), initial=0.0))
        return max(1, math.ceil(longest / self.largest_step_px))

    def _in_reach(self, camera: NightSkyCamera, u: Any, v: Any) -> Any:
        """Whether the point spread function around (u, v) can touch the frame."""
        reach = self.radius_px + 1
        return (u > -reach) & (u < camera.width + reach) & (v > -reach) & (v < camera.height + reach)

    def stars(self, scene: Any, camera: NightSkyCamera, emitter: StarEmitter) -> Any:
        """Expected electrons from stars, TensorXf (height, width, channels)."""
        width, height = camera.width, camera.height
        electrons = self.star_electrons(camera, emitter)
        channels = len(electrons)
        moments = self.moments(camera, emitter)
        total = dr.zeros(UINT64, width * height * channels)
        everyone = dr.arange(mi.UInt32, emitter.count)
        side = 2 * self.radius_px + 1
        shapes = scene.shapes()
        for moment in range(moments):
            time = FLOAT64((moment + 0.5) / moments)
            direction = emitter.direction(everyone, time)
            u, v, cosine, valid = camera.project(*direction, time)
            valid &= self._in_reach(camera, u, v) & (direction[2] >= 0)
            if shapes:
                ray = mi.Ray3f(mi.Point3f(0), mi.Vector3f(*(mi.Float(component) for component in direction)))
                valid &= ~scene.ray_test(ray)
            star = dr.compress(valid)
            if dr.width(star) == 0:
                continue
            lane = dr.arange(mi.UInt32, dr.width(star) * side * side)
            owner = dr.gather(mi.UInt32, star, lane // (side * side))
            offset = lane % (side * side)
            u, v = dr.gather(FLOAT64, u, owner), dr.gather(FLOAT64, v, owner)
            column = mi.Int32(dr.round(u)) + mi.Int32(offset % side) - self.radius_px
            row = mi.Int32(dr.round(v)) + mi.Int32(offset // side) - self.radius_px
            share = self._pixel_share(FLOAT64(column) - u) * self._pixel_share(FLOAT64(row) - v)
            pupil = FLOAT64(camera.lens.pupil(mi.Float(dr.gather(FLOAT64, cosine, owner))))
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            target = mi.UInt32(row * width + column) * channels
            for channel in range(channels):
                amount = FLOAT64(dr.gather(mi.Float, electrons[channel], owner)) * share * pupil / moments
                units = UINT64(amount * UNITS_PER_ELECTRON + 0.5)
                dr.scatter_add(total, units, target + channel, inside)
        image = mi.Float(FLOAT64(total) / UNITS_PER_ELECTRON)
        return mi.TensorXf(image, (height, width, channels))

    def _pixel_share(self, distance: Any) -> Any:
        """Integral of the Gaussian over a pixel whose centre lies `distance` px from the star, along one axis."""
        scale = 1 / (math.sqrt(2) * self.psf_sigma_px)
        return 0.5 * (dr.erf((distance + 0.5) * scale) - dr.erf((distance - 0.5) * scale))

    def to_string(self) -> str:
        """Return a short description."""
        return f"NightSkyIntegrator[psf {self.psf_sigma_px} px, {4 * self.wavelength_groups} wavelengths]"
