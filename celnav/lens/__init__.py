"""Uncertainty of a calibrated lens."""
