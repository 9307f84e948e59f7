"""Names of stars for people: proper names of bright stars, Bayer and Flamsteed designations (Yale catalogue), numbers."""

from __future__ import annotations

from functools import cache
from pathlib import Path

# Names approved by the IAU's Working Group on Star Names, by HR number.
PROPER_NAMES = {
    15: "Alpheratz", 21: "Caph", 99: "Ankaa", 168: "Schedar", 188: "Diphda", 337: "Mirach", 424: "Polaris", 472: "Achernar",
    603: "Almach", 617: "Hamal", 911: "Menkar", 936: "Algol", 1017: "Mirfak", 1457: "Aldebaran", 1708: "Capella",
    1713: "Rigel", 1790: "Bellatrix", 1791: "Elnath", 1852: "Mintaka", 1865: "Arneb", 1903: "Alnilam", 1948: "Alnitak",
    1956: "Phact", 2004: "Saiph", 2061: "Betelgeuse", 2088: "Menkalinan", 2294: "Mirzam", 2326: "Canopus", 2421: "Alhena",
    2491: "Sirius", 2618: "Adhara", 2693: "Wezen", 2827: "Aludra", 2891: "Castor", 2943: "Procyon", 2990: "Pollux",
    3165: "Naos", 3307: "Avior", 3634: "Suhail", 3685: "Miaplacidus", 3699: "Aspidiske", 3748: "Alphard", 3982: "Regulus",
    4295: "Merak", 4301: "Dubhe", 4357: "Zosma", 4534: "Denebola", 4554: "Phecda", 4660: "Megrez", 4662: "Gienah",
    4730: "Acrux", 4763: "Gacrux", 4853: "Mimosa", 4905: "Alioth", 5054: "Mizar", 5056: "Spica", 5191: "Alkaid",
    5235: "Muphrid", 5267: "Hadar", 5288: "Menkent", 5340: "Arcturus", 5459: "Rigil Kentaurus", 5506: "Izar", 5563: "Kochab",
    5685: "Zubeneschamali", 5793: "Alphecca", 5854: "Unukalhai", 5953: "Dschubba", 6134: "Antares", 6217: "Atria",
    6527: "Shaula", 6553: "Sargas", 6556: "Rasalhague", 6705: "Eltanin", 6879: "Kaus Australis", 7001: "Vega", 7121: "Nunki",
    7417: "Albireo", 7557: "Altair", 7790: "Peacock", 7796: "Sadr", 7924: "Deneb", 8162: "Alderamin", 8308: "Enif",
    8425: "Alnair", 8728: "Fomalhaut", 8775: "Scheat", 8781: "Markab",
}  # fmt: skip
_GREEK = {
    "Alp": "α", "Bet": "β", "Gam": "γ", "Del": "δ", "Eps": "ε", "Zet": "ζ", "Eta": "η", "The": "θ",
    "Iot": "ι", "Kap": "κ", "Lam": "λ", "Mu": "μ", "Nu": "ν", "Xi": "ξ", "Omi": "ο", "Pi": "π",
    "Rho": "ρ", "Sig": "σ", "Tau": "τ", "Ups": "υ", "Phi": "φ", "Chi": "χ", "Psi": "ψ", "Ome": "ω",
}  # fmt: skip
_SUPERSCRIPTS = str.maketrans("123456789", "¹²³⁴⁵⁶⁷⁸⁹")
_CATALOGUE = Path(__file__).parents[1] / "data" / "ybsc" / "catalog.dat"


def star_name(hip: int, hr: int) -> str:
    """Return the name of a star: Sirius, ε CMa, 61 Cyg, HIP 2, HR 1; empty if both catalogue numbers are 0 (none)."""
    if hr in PROPER_NAMES:
        return PROPER_NAMES[hr]
    if hr in _designations():
        return _designations()[hr]
    if hip:
        return f"HIP {hip}"
    return f"HR {hr}" if hr else ""


@cache
def _designations() -> dict[int, str]:
    """Return Bayer or Flamsteed designations by HR number (bytes 5-14 of the Yale catalogue)."""
    found = {}
    for line in _CATALOGUE.read_text(encoding="latin-1").splitlines():
        flamsteed, greek, component, constellation = (
            line[4:7].strip(), line[7:10].strip(), line[10:11].strip(), line[11:14].strip(),
        )  # fmt: skip
        if greek in _GREEK:
            found[int(line[:4])] = f"{_GREEK[greek]}{component.translate(_SUPERSCRIPTS)} {constellation}"
        elif flamsteed:
            found[int(line[:4])] = f"{flamsteed} {constellation}"
    return found
