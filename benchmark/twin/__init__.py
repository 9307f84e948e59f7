"""Twins: rendered frames with the camera, the place and the minute of real photographs, and their comparison."""
