"""Streaks that a moving camera makes of all stars."""
