"""Make generator/data/lamps.csv from the lamp spectra of colour-science: python tools/build_lamps.py."""

from __future__ import annotations

from pathlib import Path

import colour

LAMPS = {"HPS": "HPS", "LED": "Phosphor LED YAG", "LED3000": "PHOS-1", "MH": "Metal Halide", "mercury": "Mercury"}
OUT = Path(__file__).parents[1] / "generator" / "data" / "lamps.csv"

if __name__ == "__main__":
    spectra = {name: colour.SDS_LIGHT_SOURCES[key] for name, key in LAMPS.items()}
    with OUT.open("w", encoding="utf-8") as stream:
        stream.write("# Relative spectral power of street lamps, per nm. Source: colour-science SDS_LIGHT_SOURCES\n")
        stream.write("# (BSD-3-Clause): " + ", ".join(f"{name} = '{key}'" for name, key in LAMPS.items()) + "\n")
        stream.write(",".join(["wavelength_nm", *LAMPS]) + "\n")
        for wavelength in range(380, 781, 5):
            stream.write(",".join([str(wavelength), *(f"{spectra[name][wavelength]:.6g}" for name in LAMPS)]) + "\n")
