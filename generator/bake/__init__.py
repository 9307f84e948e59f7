"""Radiative transfer of city light and moonlight by random walks, stored as small maps (``skybench bake``)."""
