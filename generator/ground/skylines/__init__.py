"""Skylines from random numbers: hills, forest, roofs, masts and a street, drawn over each other from far to near."""
