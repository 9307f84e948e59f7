"""What the camera makes of its raw values: videos, developed pictures, photographs."""
