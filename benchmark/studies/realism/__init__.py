"""Photographs and their rendered twins: whether a ranking of solvers on twins predicts that on photographs."""
