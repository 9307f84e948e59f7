"""Make generator/data/stellar_templates.csv from Pickles' library: python tools/build_stellar_templates.py FOLDER.

FOLDER contains the files ``pickles_uk_N.fits`` of the library as distributed by MAST's reference atlases; the wheel of the
package EXOSIMS (BSD-3-Clause) includes them in ``EXOSIMS/TargetList/dat_uvk``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits

OUT = Path(__file__).parents[1] / "generator" / "data" / "stellar_templates.csv"
WAVELENGTHS_NM = np.arange(350.0, 1100.1, 5.0)
CHOSEN = {
    "O5V": 1, "B1V": 4, "B3V": 5, "B57V": 6, "B9V": 8, "A0V": 9, "A3V": 11, "A5V": 12, "A7V": 13, "F0V": 14, "F5V": 16,
    "F8V": 20, "G0V": 23, "G5V": 27, "G8V": 30, "G5III": 73, "G8III": 76, "K0III": 78, "K1III": 81, "K2III": 84,
    "K4III": 90, "K5III": 93, "M0III": 95, "M1III": 96, "M2III": 97, "M3III": 98, "M4III": 99, "M5III": 100, "M6III": 101,
    "M7III": 102, "M8III": 103,
}  # fmt: skip
"""Numbers of the templates in the library, from blue to red in V-I: dwarfs to G8, giants beyond."""


def main() -> None:
    """Write means of the photon spectra, weighted by triangles of 5 nm half-width, relative to their value at 550 nm."""
    columns = []
    for number in CHOSEN.values():
        with fits.open(Path(sys.argv[1]) / f"pickles_uk_{number}.fits") as file:
            wavelength = np.asarray(file[1].data["WAVELENGTH"], float) / 10
            photons = np.asarray(file[1].data["FLUX"], float) * wavelength
        fine = np.arange(345.0, 1105.01, 0.5)
        hats = np.maximum(0, 1 - np.abs(fine - WAVELENGTHS_NM[:, None]) / 5)
        means = hats @ np.interp(fine, wavelength, photons) / hats.sum(axis=1)
        columns.append(means / np.interp(550.0, WAVELENGTHS_NM, means))
    lines = [
        "# Photon spectra of stars over their value at 550 nm, means under hats of 5 nm. Source: Pickles 1998, PASP 110,",
        "# 863, from MAST's reference atlases (files pickles_uk_N.fits); made by tools/build_stellar_templates.py",
        "wavelength_nm," + ",".join(CHOSEN),
        *(
            f"{wavelength:g}," + ",".join(f"{value:.5g}" for value in row)
            for wavelength, row in zip(WAVELENGTHS_NM, np.transpose(columns), strict=True)
        ),
    ]
    OUT.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
