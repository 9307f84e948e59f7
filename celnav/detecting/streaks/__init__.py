"""Streaks of stars due to a moving camera."""
