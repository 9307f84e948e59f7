"""Twilight in spherical shells: profiles of the air, the Sun's beam, single and multiple scattering."""
