"""The surroundings of the camera: panoramas from pictures and from random numbers, and the light that they reflect."""
