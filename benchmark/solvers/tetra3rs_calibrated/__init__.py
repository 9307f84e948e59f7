"""tetra3rs with calibration."""
