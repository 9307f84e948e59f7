"""Geometry in front of the sky, lit by the sky: one bounce, from a fixed set of directions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

GREY_NM = 550.0
"""Wavelength at which a surface's reflectance is evaluated; it is taken as constant over the spectrum."""


def lit_directions(scene: Any, ray: Any, samples: int) -> Iterator[tuple[Any, Any]]:
    """Split the light that geometry reflects along rays into one part per direction of the sky.

    Directions are those of a Sobol set (the same for every pixel, which makes frames reproducible); those that other
    geometry blocks contribute nothing. There is one bounce, with grey reflectance.

    Parameters
    ----------
    scene : Scene
        Scene with an environment emitter that implements `sample_direction`.
    ray : Ray3f
    samples : int
        Number of directions.

    Yields
    ------
    weight : Float
        Factor on the sky's radiance in the direction; 0 without geometry.
    direction : Vector3f
        Direction towards the sky.
    """
    # This import takes half a second.
    from scipy.stats import qmc

    environment = scene.environment()
    si = scene.ray_intersect(ray)
    hit = si.is_valid()
    si.wavelengths = mi.Spectrum(GREY_NM)
    dr.eval(si, hit)
    points = qmc.Sobol(2, scramble=False).random_base2(int(np.ceil(np.log2(max(samples, 2)))))
    points = (points + 0.5 / len(points)) % 1.0
    context = mi.BSDFContext()
    for point in points:
        sample = mi.Point2f(dr.opaque(mi.Float, float(point[0])), dr.opaque(mi.Float, float(point[1])))
        sample = dr.zeros(mi.Point2f, dr.width(si)) + sample
        ds, _ = environment.sample_direction(si, sample, hit)
        seen = hit & (dr.dot(ds.d, si.n) != 0) & ~scene.ray_test(si.spawn_ray(ds.d), hit)
        reflected = si.bsdf().eval(context, si, si.to_local(ds.d), seen)[0]
        weight = dr.select(seen, reflected / (ds.pdf * len(points)), 0)
        dr.eval(weight, ds)
        yield weight, ds.d
