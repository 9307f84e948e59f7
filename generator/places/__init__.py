"""Positions and times: time scales, Earth orientation, catalogues, apparent places, refraction."""
