"""The diffuse night sky: components as sums of (direction map) x (spectrum), all pure functions."""
