"""Light that a camera receives from around its frame and that its lens scatters into it."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.device_arrays import aligned
from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.foreground import lit_directions
from generator.plugins.integrator import NightSkyIntegrator
from generator.plugins.stars import StarEmitter

Floats = NDArray[np.float64]

HEMISPHERE_DIRECTIONS = 1024
"""Number of evenly distributed directions over the pupil's hemisphere: the mean of a night sky over them is accurate to 1
%."""
WALL_AZIMUTHS = 72
"""Number of azimuths of the walls around a lens."""
LOBE_EXPONENT = 8
"""Exponent of the cosine of the azimuth with which a ring is lit from its own side and from the opposite one, as in
photographs of an all-sky camera."""
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


def sky_beside(scene: Any, integrator: NightSkyIntegrator, camera: NightSkyCamera, u: Floats, v: Floats) -> Floats:
    """Electrons per pixel from the sky and the foreground at positions that may be outside the frame, at mid-exposure.

    Parameters
    ----------
    scene, integrator, camera
    u, v : (n,) arrays
        Positions, px.

    Returns
    -------
    (n, channels) array
        Zero where the lens images nothing.
    """
    position = mi.Point2f(mi.Float(aligned((u + 0.5) / camera.width)), mi.Float(aligned((v + 0.5) / camera.height)))
    ray, etendue = camera.pixel_ray(dr.opaque(FLOAT64, 0.5), position)
    etendue = dr.select(dr.isfinite(etendue), etendue, 0)
    return _seen(scene, integrator, camera, ray, etendue, integrator.lit_samples)


def hemisphere_light(
    scene: Any,
    integrator: NightSkyIntegrator,
    camera: NightSkyCamera,
    per_emitter: list[tuple[StarEmitter, Floats]],
    wall_azimuths: int,
) -> tuple[Floats, Floats]:
    """Effect of all light in front of the lens, at mid-exposure, points included.

    Parameters
    ----------
    scene, integrator, camera
    per_emitter : list of (StarEmitter, (n, channels) array)
        Points of light, and their electrons on the axis.
    wall_azimuths : int
        Number of walls around the lens; 0 for a lens without walls.

    Returns
    -------
    mean : (channels,) array
        Electrons of a pixel on the axis that receives the mean over the hemisphere about the boresight, weighted by the
        pupil's projected area.
    walls : (3, wall_azimuths, channels) array
        Electrons of a pixel on the axis that receives the light of white Lambert walls around the lens, parallel to its
        axis, by their azimuth from +u to +v; then those for the light of their own side and of the opposite one, in lobes
        over the azimuth.
    """
    z = 1 - (np.arange(HEMISPHERE_DIRECTIONS) + 0.5) / HEMISPHERE_DIRECTIONS
    radius, turn = np.sqrt(1 - z * z), GOLDEN_ANGLE * np.arange(HEMISPHERE_DIRECTIONS)
    from_axis = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
    rotation = np.array([[float(np.array(part)[0]) for part in row] for row in camera.world_to_camera(FLOAT64(0.5))])
    towards: Any = mi.Vector3f(aligned((from_axis @ rotation).T))
    ray, _ = camera.pixel_ray(dr.opaque(FLOAT64, 0.5), mi.Point2f(0.5))
    ray.d = towards
    projection = camera.projection
    pixel_sr = 1 / (projection.f_px * projection.fy_px)
    light = _seen(scene, integrator, camera, ray, camera.collected * mi.Float(pixel_sr), integrator.lit_samples)
    cosine_law = camera.pupil_law == "cosine"
    walls = np.linspace(0, 2 * math.pi, wall_azimuths, endpoint=False)
    # A wall faces the axis, so it is lit from the opposite side.
    inward = -np.stack([np.cos(walls), np.sin(walls), np.zeros(wall_azimuths)])

    def weighted(directions: Floats, light: Floats) -> tuple[Floats, Floats]:
        """Sums of light (n, channels) from directions (n, 3) about the axis, per pi of solid angle or half of it."""
        ahead = directions[:, 2] > 0
        pupil = np.maximum(directions[:, 2], 0) if cosine_law else 0.5 * ahead
        on_pupil = pupil @ light / math.pi
        if not wall_azimuths:
            return on_pupil, np.zeros((3, 0, light.shape[1]))
        faced = directions @ inward
        off_axis = np.maximum(np.hypot(directions[:, 0], directions[:, 1]), 1e-9)[:, None]
        lobes = [np.maximum(side * faced / off_axis, 0) ** LOBE_EXPONENT * off_axis for side in (-1, 1)]
        lit = [(part * ahead[:, None]).T @ light for part in (np.maximum(faced, 0), *lobes)]
        return on_pupil, np.stack(lit) / math.pi

    even = 2 * math.pi / HEMISPHERE_DIRECTIONS
    mean, lit = (even * part for part in weighted(from_axis, light))
    for emitter, electrons in per_emitter:
        arriving = electrons * (pixel_sr * unhidden(scene, integrator, emitter))[:, None]
        more_mean, more_lit = weighted(emitter.directions_at_middle @ rotation.T, arriving)
        mean, lit = mean + more_mean, lit + more_lit
    return mean, lit


def relative_light(camera: NightSkyCamera) -> NDArray[np.float32]:
    """Electrons of each pixel under a uniform field relative to those of a pixel on the axis, (height x width,) array."""
    index = dr.arange(mi.UInt32, camera.width * camera.height)
    column, row = index % camera.width, index // camera.width
    position = mi.Point2f((mi.Float(column) + 0.5) / camera.width, (mi.Float(row) + 0.5) / camera.height)
    _, etendue = camera.pixel_ray(dr.opaque(FLOAT64, 0.5), position)
    projection = camera.projection
    on_axis = camera.collected / (projection.f_px * projection.fy_px)
    return np.array(dr.select(dr.isfinite(etendue), etendue / on_axis, 0))


def unhidden(scene: Any, integrator: NightSkyIntegrator, emitter: StarEmitter) -> Floats:
    """Fraction of each point's light that nothing hides, (n,) array: foreground at mid-exposure, Moon at all times."""
    whole = np.ones(emitter.count)
    open_share = np.asarray(emitter.open_share(np.arange(emitter.count), 0 * whole, whole))
    if not emitter.behind_foreground or (not scene.shapes() and integrator.surroundings is None):
        return open_share
    direction = mi.Vector3f(aligned(emitter.directions_at_middle.T.astype(np.float32)))
    free = open_share
    if scene.shapes():
        free = free * ~np.array(scene.ray_test(mi.Ray3f(mi.Point3f(0), direction)))
    if integrator.surroundings is not None:
        free = free * (1 - np.array(integrator.surroundings.alpha(direction)))
    return free


def _seen(
    scene: Any, integrator: NightSkyIntegrator, camera: NightSkyCamera, ray: Any, etendue: Any, lit_samples: int
) -> Floats:
    """Electrons along rays, (n, channels) array."""
    environment = scene.environment()
    channels = camera.film().create_block().channel_count() - 1
    count = dr.width(ray.d)
    if environment is None:
        return np.zeros((count, channels))
    terms = [mi.Float(channel) for channel in integrator.response(camera).of(environment.spectra.host())]
    image = [dr.zeros(mi.Float, count) for _ in range(channels)]
    free = dr.select(scene.ray_test(ray), mi.Float(0), mi.Float(1)) if scene.shapes() else mi.Float(1)
    landscape = integrator.surroundings
    if landscape is not None:
        found = landscape.at(ray.d)
        image = [light * (etendue * free) for light in landscape.light(found, ray.d)]
        free *= 1 - found[0]
    integrator.add_sky(image, environment.coefficients(ray.d, aureole=False), terms, etendue * free)
    if scene.shapes() and lit_samples:
        for weight, direction in lit_directions(scene, ray, lit_samples):
            integrator.add_sky(image, environment.coefficients(direction), terms, etendue * weight)
    return np.stack([np.array(plane, dtype=np.float64) for plane in image], axis=1)
