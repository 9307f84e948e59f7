"""What errors of calibration do to a position, `skybench study calibration`."""
