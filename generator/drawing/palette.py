"""Colours of all pages and figures, each with its value on a light and on a dark page.

The series are distinguishable with the common colour-vision deficiencies (after Okabe and Ito 2008, darkened or lightened
to a contrast of at least 4 to 1 with the page); figures add shapes and dashes, so that they are also distinguishable in
monochrome print.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Colour:
    """A colour of the house style: its CSS variable without the dashes, its values on light and dark pages, ``#rrggbb``."""

    name: str
    light: str
    dark: str

    @property
    def css(self) -> str:
        """CSS expression to which a page's style sheet gives a value."""
        return f"var(--{self.name})"


PAPER = Colour("paper", "#fdfdfb", "#14171b")
INK = Colour("ink", "#1b1e23", "#e6e7e4")
SOFT = Colour("soft", "#5a616b", "#9fa6af")
LINE = Colour("line", "#d9dbd7", "#343a41")
PANEL = Colour("panel", "#f4f4f0", "#1c2025")
LINK = Colour("link", "#0a5a94", "#7cc0f0")
SERIES = tuple(
    Colour(f"series-{place}", light, dark)
    for place, (light, dark) in enumerate(
        (
            ("#0072b2", "#56b4e9"),
            ("#c35a00", "#f0a53c"),
            ("#00795a", "#3fcfa5"),
            ("#a8497f", "#e08fc0"),
            ("#2b2b2b", "#e4e4e4"),
            ("#6b6bd0", "#a9a9ff"),
            ("#8a6d00", "#e0c94a"),
            ("#b02a30", "#ff8a80"),
        )
    )
)
PALETTE = (PAPER, INK, SOFT, LINE, PANEL, LINK, *SERIES)


def palette_sheet() -> str:
    """Style sheet that defines the colours of a page; the attribute ``data-theme`` overrides the reader's system."""
    values = " ".join(f"--{one.name}: light-dark({one.light}, {one.dark});" for one in PALETTE)
    return (
        f":root {{ color-scheme: light dark; {values} }}\n"
        ":root[data-theme=light] { color-scheme: light; }\n"
        ":root[data-theme=dark] { color-scheme: dark; }\n"
        "@media print { :root, :root[data-theme] { color-scheme: light; } }\n"
    )
