"""Photographs modified as if taken by other cameras, each solved blind: cut, turned, binned, compressed, with hot pixels.

python tools/other_cameras.py PHOTOGRAPH... [--windows] [--place LAT LON HEIGHT_M] [--only NAME]

Each photograph is first identified as a whole (`celnav.find_camera`); its camera and orientation are the truth for all
changes. A change counts as right where the middle of the changed picture is found within 0.1 deg (or two pixels) of its true
direction, and the width of the field agrees to 1 %. With a place, `celnav.calibrate` is also run on each of them.
"""

from __future__ import annotations

import argparse
import io
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import celnav
from celnav.calibrating.frames import CalibrationFrame
from celnav.command.calibration_frames import image_and_time
from celnav.sky.utc import parse_utc

F8 = NDArray[np.float64]


@dataclass(frozen=True)
class Changed:
    """A changed picture, and the positions of its pixels in the original.

    Attributes
    ----------
    name : str
        Name of the change.
    image : ndarray
        The picture.
    origin, across, down : ndarray, shape (2,)
        Position of its first pixel in the original, and of steps to the next column and row.
    mirrored : bool
        Whether the picture is mirrored, so that it must be refused.
    """

    name: str
    image: NDArray[np.generic]
    origin: tuple[float, float] = (0.0, 0.0)
    across: tuple[float, float] = (1.0, 0.0)
    down: tuple[float, float] = (0.0, 1.0)
    mirrored: bool = False

    def original(self, uv: F8) -> F8:
        """Positions in the original, shape (n, 2)."""
        return np.asarray(self.origin + uv[:, :1] * np.array(self.across) + uv[:, 1:] * np.array(self.down))


def eight_bits(image: F8, times: float = 1.0, gamma: float = 1.0) -> NDArray[np.uint8]:
    """Scale from the sky's 1 % level to the 99.9 % level, brighter by a factor `times`, with a power of `1 / gamma`."""
    low, high = np.percentile(image, [1, 99.9])
    return np.clip(np.rint(255 * np.clip((image - low) / (high - low) * times, 0, 1) ** (1 / gamma)), 0, 255).astype(
        np.uint8
    )


def jpeg(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Compress and decompress."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


def windows(image: F8, camera: celnav.Camera, width_deg: float, away_deg: tuple[float, ...]) -> list[Changed]:
    """Cut windows of a given width at a distance from the axis, in four directions."""
    found = []
    for away in away_deg:
        for turn in (45.0, 135.0, 225.0, 315.0):
            t, a = np.radians(turn), np.radians(away)
            (u, v), side = camera.project([[np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.cos(a)]])[0], width_deg
            half = round(np.radians(side) / 2 * camera.f_px)
            left, top = round(u) - half, round(v) - half
            height, width = image.shape[:2]
            if left >= 0 and top >= 0 and left + 2 * half <= width and top + 2 * half <= height:
                name = f"window of {width_deg:g} deg, {away:g} deg off"
                found.append(Changed(name, image[top : top + 2 * half, left : left + 2 * half], (left, top)))
    return found


def changes(image: NDArray[np.generic], rng: np.random.Generator) -> list[Changed]:
    """Return all changes of a grey photograph."""
    grey = image.astype(np.float64)
    height, width = grey.shape
    even = grey[: height // 2 * 2, : width // 2 * 2]
    binned = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4
    plain = eight_bits(grey)
    hot = grey.copy()
    at = rng.integers(0, hot.size, hot.size // 1000)
    hot.ravel()[at] += rng.exponential(np.percentile(grey, 99.9) - np.median(grey), len(at))
    bayer = grey.copy()
    bayer[::2, ::2] *= 0.6
    bayer[1::2, 1::2] *= 0.75
    shrunk = Image.fromarray(plain).resize((int(width / 1.5), int(height / 1.5)), Image.Resampling.BICUBIC)
    colour = jpeg(np.stack([eight_bits(grey, 0.8), plain, eight_bits(grey, 1.2)], axis=2), 85)
    text = plain.copy()
    text[height - 40 : height - 20, 20:300] = 255 * (rng.random((20, 280)) > 0.5)
    text[height // 2, :] = text[:, width // 2] = 255
    return [
        Changed("as it is", image),
        Changed("quarter turn", np.rot90(grey), (width - 1, 0), (0, 1), (-1, 0)),
        Changed("half turn", grey[::-1, ::-1], (width - 1, height - 1), (-1, 0), (0, -1)),
        Changed("mirrored", grey[:, ::-1], (width - 1, 0), (-1, 0), mirrored=True),
        Changed("2 x 2 binned", binned, (0.5, 0.5), (2, 0), (0, 2)),
        Changed("two thirds of its size", np.asarray(shrunk), (0.25, 0.25), (1.5, 0), (0, 1.5)),
        Changed("8 bits", plain),
        Changed("8 bits, gamma 2.2", eight_bits(grey, gamma=2.2)),
        Changed("gamma 2.2, JPEG of quality 85", jpeg(eight_bits(grey, gamma=2.2), 85)),
        Changed("JPEG of quality 60", jpeg(plain, 60)),
        Changed("four times as bright, saturated", eight_bits(grey, 4.0)),
        Changed("colours, JPEG of quality 85", colour),
        Changed("colour mosaic", bayer),
        Changed("hot pixels, one in 1000", hot),
        Changed("text and a cross of lines", text),
    ]


def judged(change: Changed, truth: celnav.FoundCamera, utc: str) -> tuple[str, str]:
    """Search the changed picture; return the verdict (right, wrong, refused) and what was found."""
    height, width = change.image.shape[:2]
    points = np.array([[(width - 1) / 2, (height - 1) / 2], [width * 0.4, height / 2], [width * 0.6, height / 2]])
    begun = time.perf_counter()
    try:
        found = celnav.find_camera(change.image, utc)
    except celnav.CelnavError as error:
        return ("right" if change.mirrored and "mirrored" in str(error) else "refused"), str(error)[:60]
    took_s = time.perf_counter() - begun
    seen = found.camera.to_rays(points) @ found.R_icrs_to_camera
    true = truth.camera.to_rays(change.original(points)) @ truth.R_icrs_to_camera
    off_deg = np.degrees(np.linalg.norm(seen[0] - true[0]))
    pixel_deg = np.degrees(np.linalg.norm(true[2] - true[1])) / (0.2 * width)
    scale = np.linalg.norm(seen[2] - seen[1]) / np.linalg.norm(true[2] - true[1])
    good = off_deg < max(0.1, 2 * pixel_deg) and abs(scale - 1) < 0.01 and not change.mirrored
    told = f"{found.stars} stars of {len(found.detections)}, {found.scatter_px:.2f} px, {off_deg:.3f} deg off, {took_s:.1f} s"
    return ("right" if good else "WRONG"), told


def calibrated(change: Changed, utc: str, place: tuple[float, float, float]) -> str:
    """Calibrate on the changed picture, and describe the result."""
    size = change.image.shape[1::-1]
    frame = CalibrationFrame(celnav.detect(change.image), parse_utc(utc), (size[0], size[1]), change.name)
    try:
        found = celnav.calibrate([frame], place[0], place[1], height_m=place[2])
    except celnav.CelnavError as error:
        return f"refused: {str(error)[:70]}"
    at = found.mount
    scatter = f"{len(found.residuals.uv)} stars, {np.sqrt((found.residuals.off_px**2).mean()):.2f} px"
    return f"{scatter}, f {found.camera.f_px:.1f} px, up {at.R_cam[:, 2].round(3)}"


def main() -> None:
    """Print a line for each change of each photograph, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", nargs="+", type=Path)
    parser.add_argument("--place", nargs=3, type=float, metavar=("LAT", "LON", "HEIGHT_M"))
    parser.add_argument("--only", default="", help="changes whose names hold this")
    parser.add_argument(
        "--windows", action="store_true", help="also windows of 60, 30 and 20 deg, up to 50 deg off the axis"
    )
    parser.add_argument("--utc", help="where the photographs do not tell it")
    arguments = parser.parse_args()
    counts: dict[str, dict[str, int]] = {}
    for path in arguments.photographs:
        image, middle, _ = image_and_time(str(path))
        utc = arguments.utc or middle or "2020-01-01T00:00:00Z"
        truth = celnav.find_camera(image, utc)
        print(f"{path.name}: {truth.stars} stars, {truth.scatter_px:.2f} px, f {truth.camera.f_px:.1f} px", flush=True)
        changed = changes(image, np.random.default_rng(1))
        if arguments.windows:
            for width_deg in (60.0, 30.0, 20.0):
                changed += windows(image.astype(np.float64), truth.camera, width_deg, (15.0, 35.0, 50.0))
        for change in changed:
            if arguments.only in change.name:
                verdict, told = judged(change, truth, utc)
                print(f"  {verdict:8}{change.name:36}{told}", flush=True)
                kind = change.name.split(",")[0] if change.name.startswith("window") else change.name
                row = counts.setdefault(kind, dict.fromkeys(("right", "refused", "WRONG"), 0))
                row[verdict] += 1
                if arguments.place is not None:
                    print(f"          calibrate: {calibrated(change, utc, tuple(arguments.place))}", flush=True)
    for name, row in counts.items():
        print(f"| {name} | {row['right']} | {row['refused']} | {row['WRONG']} |")


if __name__ == "__main__":
    main()
