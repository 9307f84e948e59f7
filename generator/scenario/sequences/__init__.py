"""Scenarios of sequences: frames at equal intervals, paths through waypoints or files, and inertial units."""
