"""The sensor: colour filters, the ordered effects between expected electrons and DN, and the pictures developed from DN.

:mod:`generator.sensor.colour` is the filter array, :mod:`generator.sensor.charge` the effects on electrons in pixels,
:mod:`generator.sensor.readout` those of the readout, :mod:`generator.sensor.develop` the 8-bit picture and
:mod:`generator.sensor.hud` the overlay. :mod:`generator.sensor.detector` puts them in order.
"""
