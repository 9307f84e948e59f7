"""Twilight in spherical shells: profiles of the air, the Sun's beam, light scattered once and more often."""
