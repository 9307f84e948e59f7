"""Light in numbers: photometry, stellar spectra, extinction, scattering in the air, lamps and the baked maps."""
