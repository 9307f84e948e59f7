"""Judging answers: distance from the truth, star identifications, and the bound that no solver can beat."""
