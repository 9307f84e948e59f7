"""Make generator/data/lamps.csv: python tools/build_lamps.py.

Up to 780 nm the lamps are those of colour-science. Beyond that, discharge lamps are those of the LICA-UCM lamps spectral
database, and the light of light-emitting diodes falls exponentially at the rate that it has before 780 nm.
"""

from __future__ import annotations

from pathlib import Path

import colour
import numpy as np

LAMPS = {"HPS": "HPS", "LED": "Phosphor LED YAG", "LED3000": "PHOS-1", "MH": "Metal Halide", "mercury": "Mercury"}
OUT = Path(__file__).parents[1] / "generator" / "data" / "lamps.csv"
LAST_OF_COLOUR_NM, LAST_NM, STEP_NM = 780, 1100, 5

# Means over 5 nm from 785 to 900 nm of two lamps of the LICA-UCM database (Tapia et al. 2017; files H_HPS_Helios and
# M_MetalHalide as distributed with the model ILLUMINA): sodium's doublet at 818.3 and 819.5 nm on a weak continuum. Beyond
# 850 nm the instrument's noise exceeds the lamps, so the mean from there to 900 nm is used up to 1100 nm. The next strong
# lines are sodium's at 1138 to 1140 nm.
BEYOND_HPS = [0.74, 0.94, 1.15, 1.10, 1.40, 1.69, 8.28, 40.97, 4.22, 1.28, 0.77, 0.64, 0.72, 0.48]
BEYOND_HPS_END = 0.45
HPS_V_MEAN = 7.525
"""Mean of the same lamp over the V band in the same unit (1e-4)."""
BEYOND_MH = [5.5, 3.1, 2.2, 3.0, 3.3, 2.3, 7.3, 88.5, 4.1, 2.1, 4.0, 2.7, 2.4, 2.1]
BEYOND_MH_END = 3.0
MH_MEAN_730_TO_760 = 3.1
"""Mean of the same lamp from 730 to 760 nm in the same unit (1e-3), by which it is joined to that of colour-science."""
FALL_FROM_NM = 740


def v_mean(power: dict[int, float]) -> float:
    """Mean of a spectral power over Bessell's V band."""
    from generator.light.photometry import BESSELL_V

    # The band's response is to photons; a mean of power is weighted by the response to energy.
    weight = BESSELL_V.response * BESSELL_V.wavelength_nm
    wavelengths = np.array(sorted(power), float)
    watts = np.array([power[int(one)] for one in wavelengths])
    fine = np.arange(BESSELL_V.wavelength_nm[0], BESSELL_V.wavelength_nm[-1])
    response = np.interp(fine, BESSELL_V.wavelength_nm, weight)
    return float(np.sum(np.interp(fine, wavelengths, watts) * response) / np.sum(response))


def extended(name: str, power: dict[int, float]) -> dict[int, float]:
    """Extend a lamp's spectral power to LAST_NM."""
    beyond = range(LAST_OF_COLOUR_NM + STEP_NM, LAST_NM + 1, STEP_NM)
    if name == "HPS":
        tail, end, scale = BEYOND_HPS, BEYOND_HPS_END, v_mean(power) / HPS_V_MEAN
    elif name == "MH":
        red = [power[wavelength] for wavelength in range(730, 761, STEP_NM)]
        tail, end, scale = BEYOND_MH, BEYOND_MH_END, float(np.mean(red)) / MH_MEAN_730_TO_760
    elif name == "mercury":
        # Mercury's next strong line is at 1014 nm.
        return power | dict.fromkeys(beyond, 0.0)
    else:
        fall = np.log(max(power[LAST_OF_COLOUR_NM], 1e-6) / power[FALL_FROM_NM]) / (LAST_OF_COLOUR_NM - FALL_FROM_NM)
        return power | {
            wavelength: power[LAST_OF_COLOUR_NM] * float(np.exp(fall * (wavelength - LAST_OF_COLOUR_NM)))
            for wavelength in beyond
        }
    values = [*tail, *[end] * (len(beyond) - len(tail))]
    return power | {wavelength: scale * value for wavelength, value in zip(beyond, values, strict=True)}


def main() -> None:
    """Write the table."""
    spectra = {
        name: extended(name, {int(w): float(colour.SDS_LIGHT_SOURCES[key][w]) for w in range(380, 781, STEP_NM)})
        for name, key in LAMPS.items()
    }
    with OUT.open("w", encoding="utf-8") as stream:
        stream.write(
            "# Relative spectral power of street lamps, per nm. Source: to 780 nm colour-science SDS_LIGHT_SOURCES\n"
        )
        stream.write(
            "# (BSD-3-Clause): " + ", ".join(f"{name} = '{key}'" for name, key in LAMPS.items()) + "; beyond,\n"
        )
        stream.write(
            "# HPS and MH of the LICA-UCM lamps spectral database (means over 5 nm). Made by tools/build_lamps.py\n"
        )
        stream.write(",".join(["wavelength_nm", *LAMPS]) + "\n")
        for wavelength in range(380, LAST_NM + 1, STEP_NM):
            stream.write(",".join([str(wavelength), *(f"{spectra[name][wavelength]:.6g}" for name in LAMPS)]) + "\n")


if __name__ == "__main__":
    main()
