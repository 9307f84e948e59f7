"""Replications of published work, as commands of `skybench study`."""
