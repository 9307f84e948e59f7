"""Apparent positions of stars: catalogue, time scales, Earth orientation, apparent places, refraction."""
