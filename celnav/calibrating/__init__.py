"""Calibration of a camera, its lens and its mount, from stars seen at a known place and time."""
