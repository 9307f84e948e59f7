"""Tasks of photographs: each photograph by address and SHA-256, the camera of another night, and the graded quantity."""
