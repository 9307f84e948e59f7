"""Cameras of the world: their figures, and which of these have no source."""
