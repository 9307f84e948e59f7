"""Rounds: a secret draws frames from published ranges once the solvers are settled; it is published afterwards."""
