"""The parts of a scenario's ``foreground`` section that surround the camera: landscapes and lamps."""
