"""Where the stars appear: catalogue, time scales, Earth orientation, apparent places, refraction."""
