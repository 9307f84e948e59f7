"""Make the README's picture from scenes/00_hello.yaml: python tools/build_pictures.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from generator.dataset_writer import render_frame
from generator.scenario_file import load_scenario

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "images" / "hello.jpg"


def stretch(dn: np.ndarray) -> np.ndarray:
    """8-bit picture of DN: arcsinh over the sky's brightness, so that faint and bright stars both show."""
    sky, spread = np.median(dn), np.percentile(dn, 75) - np.percentile(dn, 25)
    value = np.arcsinh((dn - sky + 0.3 * spread) / spread) / np.arcsinh((dn.max() - sky) / spread)
    return np.rint(255 * np.clip(1.15 * value, 0, 1)).astype(np.uint8)


if __name__ == "__main__":
    frame = render_frame(load_scenario(ROOT / "scenes" / "00_hello.yaml"), 0)
    OUT.parent.mkdir(exist_ok=True)
    Image.fromarray(stretch(frame.dn.astype(np.float64))).save(OUT, quality=88)
    print(f"{OUT.relative_to(ROOT)}: {OUT.stat().st_size / 1e3:.0f} kB")
