"""Solvers that take part in the benchmark, one module each, behind the protocol of `benchmark.protocol`."""
