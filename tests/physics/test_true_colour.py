"""Colours: from spectra through the CIE 1931 observer to sRGB, against published numbers."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from generator.colour_science import colour, srgb_encoded
from generator.gallery.fisheye import observer_weights, true_colour
from generator.light.lamps import LAMPS_PATH
from generator.light.photometry import GRID_NM

ROOT = Path(__file__).parents[2]
CIE_CHROMATICITY = {"A": (0.44758, 0.40745), "D50": (0.34567, 0.35851), "D65": (0.31272, 0.32903)}
"""x and y of CIE standard illuminants for the 2 deg observer. Source: CIE 15:2004, table T.3."""
XRITE_SRGB = {
    "dark skin": (115, 82, 68), "light skin": (194, 150, 130), "blue sky": (98, 122, 157), "foliage": (87, 108, 67),
    "blue flower": (133, 128, 177), "bluish green": (103, 189, 170), "orange": (214, 126, 44),
    "purplish blue": (80, 91, 166), "moderate red": (193, 90, 99), "purple": (94, 60, 108), "yellow green": (157, 188, 64),
    "orange yellow": (224, 163, 46), "blue": (56, 61, 150), "green": (70, 148, 73), "red": (175, 54, 60),
    "yellow": (231, 199, 31), "magenta": (187, 86, 149), "cyan": (8, 133, 161), "white 9.5 (.05 D)": (243, 243, 242),
    "neutral 8 (.23 D)": (200, 200, 200), "neutral 6.5 (.44 D)": (160, 160, 160), "neutral 5 (.70 D)": (122, 122, 121),
    "neutral 3.5 (1.05 D)": (85, 85, 85), "black 2 (1.5 D)": (52, 52, 52),
}  # fmt: skip
"""8-bit sRGB of the ColorChecker. Source: X-Rite, "Colorimetric values for ColorChecker family of targets", 2005 (under D50,
adapted to D65)."""


def photons_on_grid(distribution) -> np.ndarray:
    """A spectral power distribution of colour-science as photons on the generator's grid."""
    return np.interp(GRID_NM, distribution.wavelengths, distribution.values, left=0, right=0) * GRID_NM


@pytest.mark.parametrize("name", CIE_CHROMATICITY)
def test_standard_illuminants_have_their_published_chromaticity(name) -> None:
    xyz = observer_weights() @ photons_on_grid(colour().SDS_ILLUMINANTS[name])
    assert xyz[:2] / xyz.sum() == pytest.approx(CIE_CHROMATICITY[name], abs=2e-4)


def test_black_body_at_2856_k_has_the_colour_of_illuminant_a() -> None:
    """By Planck's law itself, with the second radiation constant of CIE 15 (0.014388 m K)."""
    metres = GRID_NM * 1e-9
    power = metres**-5 / np.expm1(1.4388e-2 / (metres * 2855.54))
    xyz = observer_weights() @ (power * GRID_NM)
    assert xyz[:2] / xyz.sum() == pytest.approx(CIE_CHROMATICITY["A"], abs=2e-4)


def test_luminance_of_monochromatic_light_is_683_lm_per_watt() -> None:
    """1 W/(m^2 sr) at 555 nm, where the eye is most sensitive: 683 cd/m^2 (the definition of the candela)."""
    photons = np.zeros_like(GRID_NM)
    peak = int(np.argmin(np.abs(GRID_NM - 555)))
    photons[peak] = 555e-9 / (6.62607015e-34 * 299792458.0) / (GRID_NM[1] - GRID_NM[0])
    assert observer_weights()[1] @ photons == pytest.approx(683.0, rel=1e-4)


def test_daylight_is_white() -> None:
    xyz = observer_weights() @ photons_on_grid(colour().SDS_ILLUMINANTS["D65"])
    assert true_colour(xyz, float(xyz[1])).tolist() == [255, 255, 255]
    assert true_colour(xyz, float(xyz[1]) / 0.21586).tolist() == [128, 128, 128]


def test_colour_checker_has_its_published_srgb() -> None:
    """Spectral reflectances under D65, to within colour differences (CIEDE2000) that an eye hardly sees.

    The published values are those of another print of the chart, computed for D50 and adapted to D65.
    """
    light = photons_on_grid(colour().SDS_ILLUMINANTS["D65"])
    white = observer_weights() @ light
    chart = colour().SDS_COLOURCHECKERS["BabelColor Average"]
    assert set(chart) == set(XRITE_SRGB)
    reflectance = np.array([np.interp(GRID_NM, patch.wavelengths, patch.values) for patch in chart.values()])
    shown = true_colour((reflectance * light) @ observer_weights().T, float(white[1]))
    published = np.array([XRITE_SRGB[name] for name in chart])
    in_lab = [colour().XYZ_to_Lab(colour().sRGB_to_XYZ(rgb / 255)) for rgb in (shown, published)]
    difference = colour().delta_E(*in_lab, method="CIE 2000")
    assert difference.mean() < 1.5
    assert difference.max() < 3.0


def test_transfer_curve_is_that_of_iec_61966() -> None:
    assert srgb_encoded(np.array([0.0, 0.0031308, 0.214041, 1.0])) == pytest.approx([0, 0.04045, 0.5, 1], abs=2e-5)


def test_lamps_are_those_of_their_source() -> None:
    """The table of lamp spectra agrees, up to 780 nm, with the library that it was taken from."""
    sources = {"HPS": "HPS", "LED": "Phosphor LED YAG", "LED3000": "PHOS-1", "MH": "Metal Halide", "mercury": "Mercury"}
    with LAMPS_PATH.open() as stream:
        lines = [line.strip().split(",") for line in stream if not line.startswith("#")]
    table = np.array(lines[1:], dtype=float)
    table = table[table[:, 0] <= 780]
    for column, name in enumerate(lines[0][1:], start=1):
        distribution = colour().SDS_LIGHT_SOURCES[sources[name]]
        expected = np.interp(table[:, 0], distribution.wavelengths, distribution.values)
        scale = table[:, column].sum() / expected.sum()
        np.testing.assert_allclose(table[:, column], scale * expected, rtol=2e-5, atol=1e-5 * table[:, column].max())


@pytest.mark.parametrize("without", ["", "matplotlib"])
def test_importing_the_libraries_changes_nothing_else(without) -> None:
    """Neither printing of numbers nor filters of warnings, and no warning escapes, with optional packages or without."""
    code = (
        "import sys, warnings\n"
        "import numpy as np, scipy.ndimage, scipy.special\n"
        "sys.modules.update(dict.fromkeys(sys.argv[1:]))\n"
        "from generator import colour_science\n"
        "before = list(warnings.filters), np.get_printoptions()\n"
        "colour_science.colour_demosaicing(), colour_science.colour()\n"
        "assert (list(warnings.filters), np.get_printoptions()) == before\n"
        "print(repr(np.float64(0.1)), np.array([0.5]))\n"
    )
    arguments = [sys.executable, "-W", "error", "-c", code, *([without] if without else [])]
    run = subprocess.run(arguments, capture_output=True, text=True, check=False, cwd=ROOT)
    assert (run.stdout, run.stderr, run.returncode) == ("np.float64(0.1) [0.5]\n", "", 0)


@pytest.mark.journey
def test_rendering_does_not_wait_for_the_libraries() -> None:
    """They are imported when a picture is developed or drawn, not before."""
    code = "import sys, generator.frame.render, benchmark.cli.app; print({'colour', 'skimage'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout == "set()\n"
