"""Tasks of photographs: each by its address and SHA-256, the camera of another night, and what is graded."""
