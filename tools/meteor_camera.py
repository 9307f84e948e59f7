"""Measure a meteor camera on its stacks: python tools/meteor_camera.py FF_*.fits.gz --mask mask.bmp [--stars FRAMES].

It prints, for the sky that the mask shows, the amplitude of the pattern that pairs of pictures share by their light, the
correlation of neighbouring pixels along rows and columns, and the number of pixels that stand out in the median of the
pictures. With `--stars`, the `frames` folder that `skybench twin` wrote for the same files in the same order, it also counts
the stars that celnav detects, by magnitude and angle off axis. The stacks of the twins, `FRAMES/*-stack.fits`, are measured
by the same command.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import binary_erosion, maximum_filter, median_filter
from scipy.spatial import cKDTree

import celnav
from benchmark.twin.stacked_video import read_stack
from celnav.reading.fits_file import unpacked_bytes

F8 = NDArray[np.float64]

BLACK = 5.5
"""Grey value without light, with half a value for the rounding down of a mean."""
FINE_PX, COARSE_PX, MARGIN_PX = 9, 25, 10
LIGHTS = (12, 14, 16, 18, 20, 23, 26, 30, 35, 40, 46)
"""Grey values at which classes of light begin; each is 12 % wide."""
LEAST_PX, LARGEST = 5000, 6.0
STANDING = (2.5, 3.5, 4.5, 5.5, 7.5)
MAGNITUDES, ANGLES_DEG, NEAR_PX = (4.0, 5.0, 5.5, 6.0, 6.5, 7.0), (0.0, 20.0, 32.0, 50.0), 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stacks", nargs="+", type=Path)
    parser.add_argument("--mask", type=Path, required=True)
    parser.add_argument("--stars", type=Path)
    given = parser.parse_args()
    sky = binary_erosion(np.asarray(Image.open(given.mask, formats=("PNG", "BMP")).convert("L")) > 0, iterations=8)
    sky[:MARGIN_PX] = sky[-MARGIN_PX:] = sky[:, :MARGIN_PX] = sky[:, -MARGIN_PX:] = False
    pictures = [read_stack(unpacked_bytes(path), path.name).mean.astype(float) for path in given.stacks]
    fine = [picture - median_filter(picture, FINE_PX) for picture in pictures]
    light = [median_filter(picture, COARSE_PX) for picture in pictures]
    print_shared(fine, light, sky)
    print_neighbours(fine, light, sky)
    print_standing(np.median(fine, axis=0), sky)
    if given.stars:
        print_stars(pictures, sky, given.stars)


def print_shared(fine: list[F8], light: list[F8], sky: NDArray[np.bool_]) -> None:
    """Standard deviations of what pairs share and of what each has alone, by the mean grey value of the two."""
    for low in LIGHTS:
        rows = []
        for one, other in itertools.combinations(range(len(fine)), 2):
            mean = (light[one] + light[other]) / 2
            kept = (
                sky
                & (np.abs(fine[one]) < LARGEST)
                & (np.abs(fine[other]) < LARGEST)
                & (mean >= low)
                & (mean < 1.12 * low)
            )
            if kept.sum() >= LEAST_PX:
                covariance = np.cov(fine[one][kept], fine[other][kept])
                rows.append((covariance[0, 1], np.trace(covariance) / 2, kept.sum()))
        if rows:
            shared, whole, count = np.array(rows).T
            common, total = np.average(shared, weights=count), np.average(whole, weights=count)
            amplitude = np.sqrt(max(common, 0.0))
            print(
                f"grey {1.06 * low:.1f}: shared {amplitude:.3f}, {amplitude / (1.06 * low - BLACK):.4f} of the light; "
                f"alone {np.sqrt(total - common):.3f}"
            )


def print_neighbours(fine: list[F8], light: list[F8], sky: NDArray[np.bool_]) -> None:
    """Correlation of pixels one and two apart along rows, then along columns, by light; means over the pictures."""
    for low in LIGHTS:
        found = []
        for picture, level in zip(fine, light, strict=True):
            kept = sky & (level >= low) & (level < 1.12 * low) & (np.abs(picture) < LARGEST)
            if kept.sum() >= LEAST_PX:
                part = np.where(kept, picture, np.nan)
                pairs = [(each[:, lag:], each[:, :-lag]) for each in (part, part.T) for lag in (1, 2)]
                found.append([np.nanmean(a * b) / np.nanvar(part) for a, b in pairs])
        if found:
            print(f"grey {1.06 * low:.1f}: neighbours", *np.mean(found, axis=0).round(2))


def print_standing(pattern: F8, sky: NDArray[np.bool_]) -> None:
    """Numbers of local maxima of the median picture, above grey values over their surroundings."""
    highest = pattern[sky & (maximum_filter(pattern, 5) == pattern)]
    print("standing out:", ", ".join(f"{int((highest > value).sum())} above {value}" for value in STANDING))


def print_stars(pictures: list[F8], sky: NDArray[np.bool_], folder: Path) -> None:
    """Stars with a detection within NEAR_PX, of all, by magnitude and angle off axis."""
    table = pq.read_table(folder / "stars.parquet", columns=["index", "v_mag", "u_px", "v_px"]).to_pandas()
    camera = json.loads((folder / "frame-00000.json").read_text(encoding="utf-8"))["camera"]
    centre, f_px = np.array([camera["cx_px"], camera["cy_px"]]), camera["f_px"]
    seen, all_stars = np.zeros((2, len(MAGNITUDES) - 1, len(ANGLES_DEG) - 1), dtype=int)
    for number, picture in enumerate(pictures):
        stars = table[table["index"] == number]
        uv = stars[["u_px", "v_px"]].to_numpy()
        at = np.clip(np.rint(uv).astype(int), 0, np.array(sky.shape)[::-1] - 1)
        inside = sky[at[:, 1], at[:, 0]]
        angle = np.degrees(np.hypot(*(uv - centre).T) / f_px)
        near = cKDTree(celnav.detect(picture.astype(np.float32)).uv).query(uv)[0] < NEAR_PX
        for counts, kept in ((all_stars, inside), (seen, inside & near)):
            counts += np.histogram2d(stars["v_mag"][kept], angle[kept], (MAGNITUDES, ANGLES_DEG))[0].astype(int)
    for row, (low, high) in enumerate(itertools.pairwise(MAGNITUDES)):
        words = (f"{seen[row, column]} of {all_stars[row, column]}" for column in range(len(ANGLES_DEG) - 1))
        print(f"V {low} to {high}, at {ANGLES_DEG} deg:", ", ".join(words))


if __name__ == "__main__":
    main()
