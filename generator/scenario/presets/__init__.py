"""Real cameras: their properties, and which of these have no source."""
