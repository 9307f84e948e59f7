"""Processing of raw values in the camera: videos, developed pictures, photographs."""
