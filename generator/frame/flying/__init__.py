"""Satellites, aircraft, meteors and false stars: positions during the exposure, and when and how brightly they shine."""
