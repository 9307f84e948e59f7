"""Contestants, one module each, behind the protocol of `benchmark.solvers.protocol`."""

from benchmark.solvers.registry import known_solvers, make_solver

__all__ = ["known_solvers", "make_solver"]
