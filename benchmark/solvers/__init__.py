"""Contestants, one module each, behind the protocol of `benchmark.protocol`."""
