"""The diffuse night sky: components, each a sum of (direction map) x (spectrum), as pure functions on a grid of directions."""
