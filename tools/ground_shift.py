"""Can the ground show how a mount has moved? python tools/ground_shift.py REFERENCE.fits.bz2 FRAMES [--altitude-deg 1 16].

FRAMES is the folder of photographs that `skybench import photos` or `skybench bench run allsky-real` wrote, REFERENCE the
photograph of their calibration. Patches about the horizon of REFERENCE (trees, roofs, hills) are looked for in each
photograph. Their displacements are compared with those due to the camera's turn since the calibration, by the stars. For each
photograph this prints the number of patches, the median displacement by the stars, the measured one, and the measured one
less that by the stars; then the turn (about the camera's x, y and z axis) by the stars, and the one that fits the
displacements.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, median_filter, shift
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from skimage.io import imread

from benchmark.frames.record_values import read_record
from celnav.camera import Camera
from celnav.reading.fits_file import read_fits

F8 = NDArray[np.float64]

HALF_PX, RIM_PX, STEP_PX = 14, 4, 12
"""Half-width of a patch, its rim that displacements move out of sight, and the spacing of patches."""
LEAST_CORRELATION, LARGEST_PX, LARGEST_SIGMA_PX = 0.8, 2.0, 0.1
STEPS, LARGEST_CONDITION = 15, 1e12


@dataclass(frozen=True)
class Patches:
    """Patches of a photograph that were found again; all arrays have one row per patch.

    Attributes
    ----------
    centres_px, displacement_px, sigma_px : (n, 2) arrays
    """

    centres_px: F8
    displacement_px: F8
    sigma_px: F8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference", type=Path)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--altitude-deg", nargs=2, type=float, default=(1.0, 16.0), metavar=("LOW", "HIGH"))
    given = parser.parse_args()
    reference = light(read_fits(given.reference).pixels)
    print(
        "| photograph | patches | by the stars, px | measured | difference | turn by the stars, deg | by the ground |"
    )
    print("|-|-|-|-|-|-|-|")
    for path in sorted(given.frames.glob("frame-?????.json")):
        record = read_record(path)
        camera = Camera.from_dict(record["told"]["camera"])
        told = np.array(record["told"]["attitude"]["R_cam"])
        about_axes = np.array(record["attitude"]["R_cam"]) @ told.T
        turned = Rotation.from_matrix(about_axes).as_rotvec()
        if not turned.any():
            continue  # no stars were found, and the record repeats the calibration
        centres = candidates(camera, told, given.altitude_deg)
        patches = found_again(reference, light(imread(path.with_suffix(".png"))), centres)
        by_turn = derivatives(camera, patches.centres_px)
        predicted = by_turn @ turned
        scatter = patches.displacement_px - predicted
        by_ground = turn_of(by_turn, patches)
        print(
            f"| {record['time']['utc_start'][:10]} | {len(predicted)} | {_median_px(predicted):.2f} | "
            f"{_median_px(patches.displacement_px):.2f} | {_median_px(scatter):.2f} | "
            f"{_words(turned)} | {_words(by_ground)} |"
        )


def light(pixels: NDArray[np.generic]) -> F8:
    """Logarithm of a photograph's light above its darkest pixels, without hot pixels, smoothed by 0.8 px."""
    values = pixels.astype(np.float64)
    smooth = median_filter(values, 3)
    values = np.where(np.abs(values - smooth) > 0.5 * smooth, smooth, values)
    return np.asarray(gaussian_filter(np.log(np.maximum(values - 0.9 * np.percentile(values, 1.0), 20.0)), 0.8))


def candidates(camera: Camera, rotation: F8, altitude_deg: tuple[float, float]) -> F8:
    """Centres of patches about the horizon, shape (n, 2), in whole pixels."""
    margin = HALF_PX + RIM_PX + 1
    v, u = np.mgrid[margin : camera.height - margin : STEP_PX, margin : camera.width - margin : STEP_PX]
    centres = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    altitude = np.degrees(np.arcsin(np.clip((camera.to_rays(centres) @ rotation)[:, 2], -1.0, 1.0)))
    return centres[(altitude > altitude_deg[0]) & (altitude < altitude_deg[1])]


def found_again(reference: F8, picture: F8, centres_px: F8) -> Patches:
    """Displacements of those patches that resemble the reference."""
    rows = []
    for u, v in centres_px.astype(int):
        reach = HALF_PX + RIM_PX
        window = np.s_[v - reach : v + reach + 1, u - reach : u + reach + 1]
        found = displacement(reference[window], picture[window])
        if found is not None:
            rows.append((u, v, *found))
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return Patches(table[:, :2], table[:, 2:4], table[:, 4:])


def displacement(before: F8, after: F8) -> tuple[float, float, float, float] | None:
    """Displacement and its standard deviations (px) between two patches, or None where they do not resemble each other.

    The light of a patch may change by a factor and a plane. Gauss-Newton steps of Lucas and Kanade (1981, Proc. IJCAI 674).
    """
    inner = np.s_[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX]
    y, x = np.mgrid[-1.0 : 1.0 : before.shape[0] * 1j, -1.0 : 1.0 : before.shape[1] * 1j]
    plane = np.column_stack([np.ones(y[inner].size), x[inner].ravel(), y[inner].ravel()])
    target = after[inner].ravel()
    moved = np.zeros(2)
    for _ in range(STEPS):
        whole: F8 = shift(before, moved[::-1], order=3, mode="nearest")
        down, right = (np.asarray(np.gradient(whole, axis=axis))[inner].ravel() for axis in (0, 1))
        columns = np.column_stack([whole[inner].ravel(), plane])
        factors: F8 = np.linalg.lstsq(columns, target)[0]
        left = target - columns @ factors
        slopes = np.column_stack([-factors[0] * right, -factors[0] * down, columns])
        step = np.linalg.lstsq(slopes, left)[0][:2]
        moved += np.clip(step, -1.0, 1.0)
        if np.abs(step).max() < 1e-3:
            break
    flat = target - plane @ np.linalg.lstsq(plane, target)[0]
    correlation = np.sqrt(max(0.0, 1.0 - left.var() / flat.var()))
    normal = slopes.T @ slopes
    alike = correlation >= LEAST_CORRELATION and factors[0] > 0.0
    if not alike or np.hypot(*moved) > LARGEST_PX or np.linalg.cond(normal) > LARGEST_CONDITION:
        return None
    sigma_x, sigma_y = (left.std() * np.sqrt(np.linalg.inv(normal).diagonal()[:2])).tolist()
    return None if max(sigma_x, sigma_y) > LARGEST_SIGMA_PX else (moved[0], moved[1], sigma_x, sigma_y)


def derivatives(camera: Camera, centres_px: F8) -> F8:
    """Displacement of what does not move with the camera, per radian about each of its axes, shape (n, 2, 3)."""
    small = 1e-4
    rays = camera.to_rays(centres_px)
    turned = [camera.project(Rotation.from_rotvec(small * axis).apply(rays)) for axis in np.eye(3)]
    return np.stack([(places - centres_px) / small for places in turned], axis=-1)


def turn_of(by_turn: F8, patches: Patches) -> F8:
    """Rotation vector (rad) that fits the displacements, shape (3,); outliers count by their distance."""
    weight = 1.0 / np.hypot(patches.sigma_px, 0.05)

    def misfit(turn: F8) -> F8:
        return np.asarray((by_turn @ turn - patches.displacement_px) * weight).ravel()

    return np.asarray(least_squares(misfit, np.zeros(3), loss="soft_l1").x)


def _median_px(displacements: F8) -> float:
    return float(np.median(np.hypot(displacements[:, 0], displacements[:, 1])))


def _words(turn: F8) -> str:
    return " ".join(f"{part:+.3f}" for part in np.degrees(turn))


if __name__ == "__main__":
    main()
