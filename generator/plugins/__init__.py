"""Mitsuba plugins of the night sky, under names that a scene dictionary can use.

========================  ==========  ===========================================================
name                      kind        module
========================  ==========  ===========================================================
``skybench_camera``       sensor      :mod:`generator.plugins.camera`
``skybench_sky``          emitter     :mod:`generator.plugins.sky`
``skybench_stars``        emitter     :mod:`generator.plugins.stars`
``skybench_integrator``   integrator  :mod:`generator.plugins.integrator`
========================  ==========  ===========================================================

Importing the modules of this package needs a Mitsuba variant; :func:`generator.mitsuba_runtime.start` sees to it.
"""

from __future__ import annotations


def register() -> None:
    """Register the plugins with the current Mitsuba variant."""
    import mitsuba as mi

    from generator.plugins.camera import NightSkyCamera
    from generator.plugins.integrator import NightSkyIntegrator
    from generator.plugins.sky import DiffuseSkyEmitter
    from generator.plugins.stars import StarEmitter

    mi.register_sensor("skybench_camera", NightSkyCamera)
    mi.register_emitter("skybench_sky", DiffuseSkyEmitter)
    mi.register_emitter("skybench_stars", StarEmitter)
    mi.register_integrator("skybench_integrator", NightSkyIntegrator)
