"""``skybench_integrator``: expected electrons of a night-sky scene, without Monte Carlo noise.

The diffuse sky is sampled by camera rays through the pixels' centres, and its spectra are integrated over the film's
response. Stars are projected by the same sensor at many moments of the exposure (:mod:`generator.plugins.star_tracks`)
and spread over pixels by the point spread function (:mod:`generator.plugins.star_splats`). Geometry in front of the sky
is a dark silhouette, unless ``lit_samples`` sets the number of directions from which the sky lights it.

=======================  =======  ================================================================================
parameter                type     meaning
=======================  =======  ================================================================================
``psf_sigma_px``         float    standard deviation of a Gaussian point spread function, px; or
``psf_stamps``           tensor   (bands, rows, columns, …): see :class:`generator.plugins.psf_atlas.PsfAtlas`
``psf_shift``            tensor   (bands,): lateral chromatic shift at the corner, px
``psf_inside``           tensor   (radius + 1, bands, rows, columns): light within squares of 1, 3, 5 … px
``psf_beyond``           tensor   (radius + 1,): largest fraction in a pixel outside them
``wavelength_groups``    int      groups of four wavelengths per pixel (default 33: a wavelength every 4.9 nm)
``largest_step_px``      float    longest step of a star between two moments of the exposure
``coverage_moments``     int      moments at which geometry is tested against each pixel (default 1)
``sky_moments``          int      moments of the exposure at which the sky is sampled (default 1)
``lit_samples``          int      directions from which the sky lights geometry (default 0: silhouettes)
``landscape_maps``       tensor   ((rows + 2) x (columns + 2) x planes,): texels as in
                                  :class:`generator.ground.surface_textures.Surface` (optional)
``landscape_planes``     int      numbers of a texel
``landscape_shines``     boolean  whether its own light counts
``landscape_terms``      tensor   (channels x azimuths x 8,): light of each surface, from the second number on
``landscape_cells``      tensor   (180 x 360,): 1 for cells of 1 deg of the sphere with any of it, from the zenith and north
``landscape_channels``   int      channels of the terms
``landscape_rows``       int      rows of the maps; likewise ``landscape_columns``
``landscape_top_deg``    float    altitude of their upper edge; likewise ``landscape_bottom_deg``, and if they are a part of
                                  the circle ``landscape_first_column`` and ``landscape_whole_columns`` (0: all of it)
``surroundings_maps``    tensor   the same of the whole circle, coarser, for light from outside the frame (with its edges)
=======================  =======  ================================================================================
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.plugins.camera import FLOAT64, FilmPoints, NightSkyCamera
from generator.plugins.film_response import WAVELENGTH_GROUPS, FilmResponse, film_response
from generator.plugins.filter_array import Pattern, choose
from generator.plugins.foreground import lit_directions
from generator.plugins.landscape import PIXEL_SAMPLES, texture
from generator.plugins.psf_atlas import PsfAtlas
from generator.plugins.scene_tensors import array
from generator.plugins.stamp_light import StampLight, gaussian_light
from generator.plugins.star_splats import (
    LightSum,
    all_electrons,
    brightest_channel,
    splat_atlas,
    splat_gaussian,
)
from generator.plugins.star_tracks import StarTracks, by_band, dispersed, follow_stars
from generator.plugins.stars import StarEmitter

PSF_RADIUS_SIGMAS = 6.0
"""Radius of a Gaussian's largest stamp; 2e-9 of the light is beyond it along each axis."""
FAINT_STEPS = ((2000.0, 2.0), (100.0, 4.0))
"""Factors on the step for stars with fewer electrons: with four times half the width the image ripples by 2 %."""
LOOKS_AT_ONCE = 4
"""Samples of a landscape in one launch."""


class NightSkyIntegrator(mi.SamplingIntegrator):
    """See the module's description."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.stamps = mi.TensorXf(props["psf_stamps"]) if "psf_stamps" in props else None
        self.band_shift = array(props["psf_shift"], 1) if "psf_shift" in props else np.zeros(1)
        self.psf_sigma_px = float(props.get("psf_sigma_px", 0.0))
        if self.stamps is None and self.psf_sigma_px <= 0:
            raise ValueError("skybench_integrator: give psf_sigma_px or psf_stamps")
        self.wavelength_groups = int(props.get("wavelength_groups", WAVELENGTH_GROUPS))
        # The midpoint rule over a Gaussian is exact to 1e-6 at steps of half its width, the pixel's own included.
        width = math.hypot(self.psf_sigma_px, math.sqrt(1 / 12))
        self.largest_step_px = float(props.get("largest_step_px", 0.5 * width if self.stamps is None else 0.35))
        self._response: FilmResponse | None = None
        self._electrons: dict[tuple[str, int], NDArray[np.float64]] = {}
        self.coverage_moments = int(props.get("coverage_moments", 1))
        self.sky_moments = int(props.get("sky_moments", 1))
        self.lit_samples = int(props.get("lit_samples", 0))
        self.landscape = texture(props, "landscape")
        self.surroundings = texture(props, "surroundings")
        self.radius_px = math.ceil(PSF_RADIUS_SIGMAS * self.psf_sigma_px + 0.5)
        if self.stamps is None:
            self.stamp_light = gaussian_light(self.psf_sigma_px, self.radius_px)
        else:
            self.stamp_light = StampLight(array(props["psf_inside"], 4), array(props["psf_beyond"], 1))
            self.radius_px = self.stamp_light.radius_px

    @property
    def bands(self) -> int:
        """Wavelength bands of the point spread function."""
        return 1 if self.stamps is None else self.stamps.shape[0]

    def render(
        self,
        scene: Any,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> Any:
        """Mitsuba's interface; `seed` and `spp` are ignored, because nothing is sampled at random.

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

    def diffuse(self, scene: Any, camera: NightSkyCamera, pattern: Pattern | None = None) -> Any:
        """Expected electrons from the diffuse sky, TensorXf (height, width, channels); with a filter array one channel."""
        return self.diffuse_and_cover(scene, camera, pattern)[0]

    def diffuse_and_cover(self, scene: Any, camera: NightSkyCamera, pattern: Pattern | None = None) -> tuple[Any, Any]:
        """:meth:`diffuse`, and the fraction of each pixel, TensorXf (height, width), that is not sky."""
        film = camera.film()
        width, height = camera.width, camera.height
        channels = film.create_block().channel_count() - 1
        environment = scene.environment()
        planes = channels if pattern is None else 1
        if environment is None:
            return dr.zeros(mi.TensorXf, (height, width, planes)), dr.ones(mi.TensorXf, (height, width))
        pixel, points = dr.arange(mi.UInt32, width * height), FilmPoints.middles(width, height)
        free = self._uncovered(scene, camera, points)
        image = [dr.zeros(mi.Float, width * height) for _ in range(planes)]
        seen = None if pattern is None else (pattern, mi.Int32(pixel % width), mi.Int32(pixel // width))
        if self.landscape is not None:
            free = free * self._add_landscape(image, camera, points, free, seen)
        terms = [mi.Float(channel) for channel in self.response(camera).of(environment.spectra.host())]
        if self.landscape is None:
            self._add_moments(image, environment, camera, points, terms, free, seen)
        else:
            # Where a landscape hides the sky, the sky is not evaluated.
            open_sky = dr.compress(free > 0)
            if dr.width(open_sky):
                part = [dr.zeros(mi.Float, dr.width(open_sky)) for _ in range(planes)]
                those = None if seen is None else (seen[0], *(dr.gather(mi.Int32, each, open_sky) for each in seen[1:]))
                share = dr.gather(mi.Float, free, open_sky)
                self._add_moments(part, environment, camera, points.of(open_sky), terms, share, those)
                for plane, light in zip(image, part, strict=True):
                    dr.scatter_add(plane, light, open_sky)
        if scene.shapes() and self.lit_samples:
            for look in range(self.coverage_moments):
                ray, etendue = camera.line_ray(dr.opaque(FLOAT64, (look + 0.5) / self.coverage_moments), points)
                etendue /= self.coverage_moments
                for weight, direction in lit_directions(scene, ray, self.lit_samples):
                    self.add_sky(image, environment.coefficients(direction), terms, etendue * weight, seen)
        ray, etendue = camera.line_ray(dr.opaque(FLOAT64, 0.5), points)
        cover = dr.select((ray.d.z >= environment.lowest_sine) & (etendue > 0), 1 - free, 1) + dr.zeros(
            mi.Float, width * height
        )
        return mi.TensorXf(interleaved(image), (height, width, planes)), mi.TensorXf(cover, (height, width))

    def _add_landscape(
        self,
        image: list[Any],
        camera: NightSkyCamera,
        points: FilmPoints,
        free: Any,
        seen: tuple[Pattern, Any, Any] | None,
    ) -> Any:
        """Add the landscape's light to planes where no geometry covers it (`free`); returns what it leaves of each pixel."""
        assert self.landscape is not None
        landscape = self.landscape
        middle, _ = camera.line_ray(dr.opaque(FLOAT64, 0.5), points)
        near = landscape.around(camera.swept_rad + camera.pixel_rad)
        chosen = dr.compress(dr.gather(mi.Float, near, landscape.cell(middle.d)) > 0)
        left = dr.full(mi.Float, 1, dr.width(points.line))
        if not dr.width(chosen):
            return left
        those = points.of(chosen)
        # Each sample has a moment and a place in the pixel of its own.
        looks = len(PIXEL_SAMPLES) * math.ceil(self.coverage_moments / len(PIXEL_SAMPLES))
        means: list[Any] = []
        for look in range(looks):
            u, v = PIXEL_SAMPLES[look % len(PIXEL_SAMPLES)]
            offset = mi.Vector2f(dr.opaque(mi.Float, u / camera.width), dr.opaque(mi.Float, v / camera.height))
            ray, _ = camera.line_ray(dr.opaque(FLOAT64, (look + 0.5) / looks), those.moved(offset))
            found = landscape.at(ray.d)
            means = [
                dr.fma(value, 1 / looks, so_far)
                for value, so_far in zip(found, means or [mi.Float(0)] * len(found), strict=True)
            ]
            if look % LOOKS_AT_ONCE == LOOKS_AT_ONCE - 1 and look + 1 < looks:
                dr.eval(means)
        middle, etendue = camera.line_ray(dr.opaque(FLOAT64, 0.5), those)
        factor = etendue * (free if dr.width(free) == 1 else dr.gather(mi.Float, free, chosen))
        if seen is not None:
            pattern, column, row = seen
            seen = pattern, dr.gather(mi.Int32, column, chosen), dr.gather(mi.Int32, row, chosen)
        for plane, light in zip(image, landscape.light(means, middle.d, seen), strict=True):
            dr.scatter_add(plane, light * factor, chosen)
        dr.scatter(left, dr.maximum(1 - means[0], 0), chosen)
        dr.eval(image, left)
        return left

    def _add_moments(
        self,
        image: list[Any],
        environment: Any,
        camera: NightSkyCamera,
        points: FilmPoints,
        terms: list[Any],
        free: Any,
        seen: tuple[Pattern, Any, Any] | None,
    ) -> None:
        """Add the sky's light at all sampled moments, weighted by the fraction of pixels that is `free`."""
        for look in range(self.sky_moments):
            ray, etendue = camera.line_ray(dr.opaque(FLOAT64, (look + 0.5) / self.sky_moments), points)
            etendue *= free / self.sky_moments
            self.add_sky(image, environment.coefficients(ray.d), terms, etendue, seen)

    def add_sky(
        self,
        image: list[Any],
        coefficients: list[Any],
        terms: list[Any],
        etendue: Any,
        seen: tuple[Pattern, Any, Any] | None = None,
    ) -> None:
        """Add light of the sky to planes: a sum of terms, each a value for the direction times an integrated spectrum."""
        lights = []
        for spectrum in terms:
            light = mi.Float(0)
            for term, value in enumerate(coefficients):
                light = dr.fma(value, dr.gather(mi.Float, spectrum, mi.UInt32(term)), light)
            lights.append(dr.maximum(light, 0) * etendue)
        if seen is not None:
            pattern, column, row = seen
            lights = [choose(pattern, lights, column, row)]
        image[:] = [so_far + light for so_far, light in zip(image, lights, strict=True)]
        dr.eval(image)

    def _uncovered(self, scene: Any, camera: NightSkyCamera, points: FilmPoints) -> Any:
        """Fraction of the exposure (Float) during which no geometry covers each pixel."""
        if not scene.shapes():
            return mi.Float(1)
        free = mi.Float(0)
        for look in range(self.coverage_moments):
            ray, _ = camera.line_ray(dr.opaque(FLOAT64, (look + 0.5) / self.coverage_moments), points)
            free += dr.select(scene.ray_test(ray), 0, mi.Float(1 / self.coverage_moments))
            dr.eval(free)
        return free

    def response(self, camera: NightSkyCamera) -> FilmResponse:
        """Spectral response of the camera's film."""
        if self._response is None:
            self._response = film_response(camera, self.wavelength_groups)
        return self._response

    def electrons_by_band(self, camera: NightSkyCamera, emitter: StarEmitter, bands: int) -> NDArray[np.float64]:
        """Expected electrons of each star as if on the boresight, over the whole point spread function.

        Returns
        -------
        (stars, channels, bands) array
            Electrons in equal bands of the spectral range.
        """
        if (emitter.id(), bands) not in self._electrons:
            shape = self.response(camera).of_stars(
                emitter.colour_table.host(),
                emitter.optical_depth.host(),
                np.array(emitter.colour_row, dtype=np.float64),
                np.array(emitter.colour_column, dtype=np.float64),
                np.array(emitter.airmass, dtype=np.float64),
                bands,
            )
            light = np.array(emitter.brightness, dtype=np.float64) * float(camera.collected[0])
            self._electrons[emitter.id(), bands] = light[:, None, None] * shape
        return self._electrons[emitter.id(), bands]

    def forget(self, emitter: StarEmitter) -> None:
        """Drop cached data of an emitter, for another one of the same name."""
        for key in [key for key in self._electrons if key[0] == emitter.id()]:
            del self._electrons[key]

    def follow(self, scene: Any, camera: NightSkyCamera, emitter: StarEmitter) -> StarTracks:
        """Tracks of all stars of an emitter over the exposure."""
        reach = self.radius_px + 1 + float(np.abs(self.band_shift).max())
        # For a faint star, photon noise exceeds the ripple by far.
        electrons = brightest_channel(self.electrons_by_band(camera, emitter, self.bands))
        step = np.full(len(electrons), self.largest_step_px)
        for faint_e, factor in FAINT_STEPS:
            step[electrons < faint_e] = factor * self.largest_step_px
        step = np.maximum(step, emitter.step_px)
        return follow_stars(scene, camera, emitter, reach, step, self.landscape)

    def stars(
        self,
        scene: Any,
        camera: NightSkyCamera,
        emitter: StarEmitter,
        tracks: StarTracks | None = None,
        pattern: Pattern | None = None,
    ) -> Any:
        """Expected electrons from stars, TensorXf (height, width, channels); with a filter array one channel.

        `tracks` are those of :meth:`follow`.
        """
        tracks = self.follow(scene, camera, emitter) if tracks is None else tracks
        electrons = self.electrons_by_band(camera, emitter, self.bands)
        planes = electrons.shape[1] if pattern is None else 1
        total = LightSum(camera.width, camera.height, planes, all_electrons(tracks, electrons))
        spread = dispersed(camera, emitter)
        parts = [(tracks, electrons)]
        if spread is not None:
            parts = list(by_band(tracks, electrons, self.electrons_by_band(camera, emitter, spread.bands), spread))
        for moments, light in parts:
            if not len(moments.star):
                continue
            if self.stamps is None:
                sigma_px = self.psf_sigma_px
                splat_gaussian(total, camera, moments, light[:, :, 0], sigma_px, self.stamp_light, pattern)
            else:
                splat_atlas(total, camera, moments, light, self.atlas(camera), self.stamp_light, pattern)
        return total.image()

    def dispersion_shift(self, camera: NightSkyCamera, emitter: StarEmitter) -> NDArray[np.float64] | None:
        """Mean shift of each star's light by atmospheric dispersion, px, (stars, 2) array; None without dispersion."""
        spread = dispersed(camera, emitter)
        if spread is None:
            return None
        fine = self.electrons_by_band(camera, emitter, spread.bands)
        return spread.mean_shift(fine.sum(axis=1), emitter.count)

    def atlas(self, camera: NightSkyCamera) -> PsfAtlas:
        """The tabulated point spread function over a camera's frame."""
        projection = camera.projection
        corner = projection.corner_px(camera.width, camera.height)
        return PsfAtlas(
            self.stamps, self.band_shift, camera.width, camera.height, projection.cx_px, projection.cy_px, corner
        )

    def to_string(self) -> str:
        """Return a short description."""
        psf = f"{self.psf_sigma_px} px" if self.stamps is None else f"table of {self.stamps.shape}"
        return f"NightSkyIntegrator[psf {psf}, {4 * self.wavelength_groups} wavelengths]"


def interleaved(planes: list[Any]) -> Any:
    """Interleave the planes' values (Floats of equal length), pixel by pixel."""
    if len(planes) == 1:
        return planes[0]
    values = dr.zeros(mi.Float, len(planes) * dr.width(planes[0]))
    for number, plane in enumerate(planes):
        dr.scatter(values, plane, dr.arange(mi.UInt32, dr.width(plane)) * len(planes) + number)
    return values
