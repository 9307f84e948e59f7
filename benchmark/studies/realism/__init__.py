"""Photographs and their rendered twins: whether a ranking of solvers on the one foretells that on the other."""
