"""Radiative transfer of city light and moonlight with Mitsuba's ``volpath``, stored as small maps (``skybench bake``)."""
