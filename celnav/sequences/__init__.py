"""Many frames: of a moving vehicle (track), of a fixed camera (night), or of several cameras at one instant (cameras)."""
