"""Rounds: frames that a secret draws from published ranges, after the solvers are settled, and that are opened afterwards."""
