"""Contributions to the covariance of a fix beyond the scatter of single stars: lens, air, and errors shared by neighbours."""
