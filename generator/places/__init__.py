"""Where things are and when: time scales, Earth orientation, catalogues, apparent places, refraction."""
