"""Geometry in front of the sky, lit by the sky: one bounce, from a fixed set of directions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.stats import qmc


def lit_radiance(scene: Any, ray: Any, samples: int) -> Iterator[tuple[Any, Callable[[Any], Any]]]:
    """Split the radiance that geometry sends back along rays into one part per direction of the sky.

    Light from the environment, from directions of a Hammersley-like Sobol set (the same for every pixel, so the same bytes
    come again), unless other geometry blocks it; one bounce.

    Parameters
    ----------
    scene : Scene
        With an environment emitter whose `sample_direction` works.
    ray : Ray3f
    samples : int
        Directions.

    Yields
    ------
    weight : Float
        What the radiance is to be multiplied with; 0 where there is no geometry.
    radiance : callable
        Wavelengths (Spectrum) to radiance (Spectrum).
    """
    environment = scene.environment()
    si = scene.ray_intersect(ray)
    hit = si.is_valid()
    dr.eval(si, hit)
    points = qmc.Sobol(2, scramble=False).random_base2(int(np.ceil(np.log2(max(samples, 2)))))
    points = (points + 0.5 / len(points)) % 1.0
    context = mi.BSDFContext()
    for point in points:
        sample = mi.Point2f(dr.opaque(mi.Float, float(point[0])), dr.opaque(mi.Float, float(point[1])))
        sample = dr.zeros(mi.Point2f, dr.width(si)) + sample
        ds, _ = environment.sample_direction(si, sample, hit)
        seen = hit & (dr.dot(ds.d, si.n) != 0) & ~scene.ray_test(si.spawn_ray(ds.d), hit)
        weight = dr.select(seen, 1 / (ds.pdf * len(points)), 0)
        dr.eval(weight, ds)

        def radiance(wavelengths: Any, ds: Any = ds, seen: Any = seen) -> Any:
            here = mi.SurfaceInteraction3f(si)
            here.wavelengths = wavelengths
            reflected = here.bsdf().eval(context, here, here.to_local(ds.d), seen)
            return reflected * environment.eval_direction(here, ds, seen)

        yield weight, radiance
