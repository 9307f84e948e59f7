"""Running solvers over frames and keeping their results."""
