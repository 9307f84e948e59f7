"""Many frames: a vehicle under way (track), a fixed camera (night)."""
