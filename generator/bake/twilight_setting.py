"""Air, directions and places of the Sun at which walks of twilight are compared with quadrature."""

JUDGED_RAYLEIGH, JUDGED_AEROSOL = 0.0973, 0.05
JUDGED_VIEWS_DEG, JUDGED_DEPRESSIONS_DEG, JUDGED_AZIMUTHS_DEG = (20.0, 90.0), (3.0, 6.0, 9.0), (0.0, 180.0)
