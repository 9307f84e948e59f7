"""The sensor: colour filters, the ordered effects between expected electrons and DN, and what is made of the DN.

:mod:`generator.sensor.colour` is the filter array, :mod:`generator.sensor.charge` what happens to electrons in pixels,
:mod:`generator.sensor.readout` what happens on the way to DN, :mod:`generator.sensor.develop` the 8-bit picture and
:mod:`generator.sensor.hud` the overlay. :mod:`generator.sensor.detector` puts them in order.
"""
