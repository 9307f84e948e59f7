"""Mitsuba plugins of the night sky, under names that a scene dictionary can use.

========================  ==========  ===========================================================
name                      kind        module
========================  ==========  ===========================================================
``skybench_camera``       sensor      :mod:`generator.plugins.camera`
``skybench_sky``          emitter     :mod:`generator.plugins.sky`
``skybench_stars``        emitter     :mod:`generator.plugins.stars`
``skybench_integrator``   integrator  :mod:`generator.plugins.integrator`
========================  ==========  ===========================================================

Importing the modules of this package needs a Mitsuba variant, which :func:`start` sets.
"""

from __future__ import annotations

import functools
from typing import Any

from generator import mitsuba_runtime


@functools.cache
def start() -> Any:
    """Start Mitsuba, register the plugins with its variant, to which they are then bound, and return the module."""
    mi = mitsuba_runtime.start()
    from generator.plugins.camera import NightSkyCamera
    from generator.plugins.integrator import NightSkyIntegrator
    from generator.plugins.sky import DiffuseSkyEmitter
    from generator.plugins.stars import StarEmitter

    mi.register_sensor("skybench_camera", NightSkyCamera)
    mi.register_emitter("skybench_sky", DiffuseSkyEmitter)
    mi.register_emitter("skybench_stars", StarEmitter)
    mi.register_integrator("skybench_integrator", NightSkyIntegrator)
    return mi
