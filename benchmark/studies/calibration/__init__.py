"""Effects of calibration errors on a position, `skybench study calibration`."""
