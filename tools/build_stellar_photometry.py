"""Make tests/physics/stellar_photometry.csv from published spectra: python tools/build_stellar_photometry.py FOLDER.

FOLDER contains MAST's reference atlases as the wheel of the package EXOSIMS (BSD-3-Clause) includes them in
``EXOSIMS/TargetList``: ``dat_uvk/pickles_uk_N.fits`` and ``bpgs/bpgs_N.fits``. Each spectrum is integrated on its own
wavelengths, so that neither the generator's grid nor its templates have a part in the numbers.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from generator.light.photometry import BESSELL_B, BESSELL_I, BESSELL_V

OUT = Path(__file__).parents[1] / "tests" / "physics" / "stellar_photometry.csv"
TYPES = (
    "O5V O9V B0V B1V B3V B5-7V B8V B9V A0V A2V A3V A5V A7V F0V F2V F5V wF5V F6V rF6V F8V wF8V rF8V G0V wG0V rG0V G2V G5V "
    "wG5V rG5V G8V K0V rK0V K2V K3V K4V K5V K7V M0V M1V M2V M2.5V M3V M4V M5V M6V B2IV B6IV A0IV A4-7IV F0-2IV F5IV F8IV "
    "G0IV G2IV G5IV G8IV K0IV K1IV K3IV O8III B1-2III B3III B5III B9III A0III A3III A5III A7III F0III F2III F5III G0III "
    "G5III wG5III rG5III G8III wG8III K0III wK0III rK0III K1III wK1III rK1III K2III wK2III rK2III K3III wK3III rK3III "
    "K4III wK4III rK4III K5III rK5III M0III M1III M2III M3III M4III M5III M6III M7III M8III M9III M10III B2II B5II F0II "
    "F2II G5II K0-1II K3-4II M3II B0I B1I B3I B5I B8I A0I A2I F0I F5I F8I G0I G2I G5I G8I K2I K3I K4I M2I"
)
"""Types of templates 1 to 131: Pickles 1998, PASP 110, 863, table 2."""
QE_NM = np.array([350, 400, 450, 500, 550, 600, 650, 700, 750, 800, 850, 900, 950, 1000])
QE = np.array([0.20, 0.45, 0.65, 0.75, 0.78, 0.75, 0.70, 0.62, 0.53, 0.42, 0.32, 0.22, 0.12, 0.05])
"""Quantum efficiency of a monochrome CMOS sensor; the test has the same."""


def measured(wavelength_nm: NDArray[np.float64], photons: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return B-V, V-I, and the sensor's electrons over the mean photon irradiance in V, nm."""
    b_mag, v_mag, i_mag = (float(band.magnitude(wavelength_nm, photons)) for band in (BESSELL_B, BESSELL_V, BESSELL_I))
    inside = wavelength_nm[(wavelength_nm > QE_NM[0]) & (wavelength_nm < QE_NM[-1])]
    fine = np.unique(np.concatenate([inside, np.arange(QE_NM[0], QE_NM[-1] + 0.25, 0.5)]))
    electrons = np.trapezoid(np.interp(fine, wavelength_nm, photons) * np.interp(fine, QE_NM, QE), fine)
    return b_mag - v_mag, v_mag - i_mag, float(electrons / BESSELL_V.mean(wavelength_nm, photons))


def main() -> None:
    """Write one row for each spectrum."""
    folder = Path(sys.argv[1])
    lines = [
        "# Colours of published spectra, and a monochrome sensor's electrons over the mean photon irradiance in V, nm;",
        "# made by tools/build_stellar_photometry.py. pickles: Pickles 1998, PASP 110, 863. gunn_stryker: Gunn & Stryker",
        "# 1983, ApJS 52, 121, as MAST's atlas BPGS has them; none of these stars has a part in the generator's templates.",
        "source,star,bv_mag,vi_mag,electrons_nm",
    ]
    for source, pattern in (("pickles", "dat_uvk/pickles_uk_*.fits"), ("gunn_stryker", "bpgs/bpgs_*.fits")):
        for path in sorted(folder.glob(pattern), key=lambda path: int(path.stem.rpartition("_")[2])):
            with fits.open(path) as file:
                wavelength = np.asarray(file[1].data["WAVELENGTH"], float) / 10
                photons = np.asarray(file[1].data["FLUX"], float) * wavelength
                name = str(file[0].header.get("TARGETID", "")).strip()
            if source == "pickles":
                name = TYPES.split()[int(path.stem.rpartition("_")[2]) - 1]
            bv_mag, vi_mag, electrons = measured(wavelength, photons)
            lines.append(f"{source},{name},{bv_mag:.3f},{vi_mag:.3f},{electrons:.1f}")
    OUT.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
