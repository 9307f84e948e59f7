"""Make the README's picture from scenes/00_hello.yaml: python tools/build_pictures.py."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from generator.frame.pictures import stretch
from generator.frame.render import render_frame
from generator.scenario.file import load_scenario

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "images" / "hello.jpg"


if __name__ == "__main__":
    frame = render_frame(load_scenario(ROOT / "scenes" / "00_hello.yaml"), 0)
    OUT.parent.mkdir(exist_ok=True)
    Image.fromarray(stretch(frame.dn)).save(OUT, quality=88)
    print(f"{OUT.relative_to(ROOT)}: {OUT.stat().st_size / 1e3:.0f} kB")
