"""Common properties of all stars in an image, from its autocorrelation, before any star is found."""
