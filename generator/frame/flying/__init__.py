"""Satellites, aircraft, meteors and false stars: where they are during the exposure, when they shine, and how bright."""
