"""Calibrate each frame of a round by itself, from nothing but its image, place, time and air, and compare with its camera.

    python tools/blind_calibrations.py out/round-truth --jobs 2

The folder is that of `skybench bench round pack --truth`. A frame's error is that of its found lens and attitude together: by
how much the places of directions spread over the frame above 8 deg of altitude are off.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import celnav
from celnav.sky.utc import parse_utc

LOWEST_DEG = 8.0
GRID = (13, 9)
EDGE_PX = 20


@dataclass(frozen=True)
class Outcome:
    """What a blind calibration of one frame found.

    Attributes
    ----------
    frame, camera : str
    detections, stars : int
        Lights in the image, and stars that the calibration was fitted to; 0 where it refused.
    middle_px, largest_px : float
        Median and largest error over the frame.
    focal_z : float
        Error of the focal length in standard deviations.
    seconds : float
    refusal : str
    """

    frame: str
    camera: str
    detections: int
    stars: int = 0
    middle_px: float = float("nan")
    largest_px: float = float("nan")
    focal_z: float = float("nan")
    seconds: float = 0.0
    refusal: str = ""


def directions_and_places(camera: celnav.Camera, R_cam: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Directions, (n, 3), east-north-up, of a grid over the frame above the lowest altitude, and their places, (n, 2), px."""
    across = np.linspace(EDGE_PX, camera.width - 1 - EDGE_PX, GRID[0])
    down = np.linspace(EDGE_PX, camera.height - 1 - EDGE_PX, GRID[1])
    uv = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    enu = camera.to_rays(uv) @ R_cam
    seen = np.isfinite(enu).all(axis=1) & (enu[:, 2] > np.sin(np.radians(LOWEST_DEG)))
    return enu[seen], uv[seen]


def calibrated(record_path: Path) -> Outcome:
    """Calibrate one frame."""
    record: dict[str, Any] = json.loads(record_path.read_text(encoding="utf-8"))
    truth, site = celnav.Camera.from_json(record_path), record["site"]
    kind = f"{truth.model}, {truth.width} x {truth.height}"
    found = celnav.detect(celnav.read_image(record_path.with_suffix(".png")))
    outcome = Outcome(record_path.parent.name, kind, len(found.uv))
    size = truth.width, truth.height
    frame = celnav.CalibrationFrame(found, parse_utc(record["time"]["utc_mid"]), size, outcome.frame)
    started = time.perf_counter()
    air = record["atmosphere"]
    try:
        result = celnav.calibrate(
            [frame], lat_deg=site["latitude_deg"], lon_deg=site["longitude_deg"], height_m=site["height_m"],
            pressure_hpa=air["pressure_hpa"], temperature_c=air["temperature_c"],
        )  # fmt: skip
    except celnav.CelnavError as error:
        return dataclasses.replace(outcome, refusal=str(error), seconds=time.perf_counter() - started)
    (attitude,) = result.attitudes
    enu, uv = directions_and_places(truth, np.array(record["attitude"]["R_cam"]))
    off_px = np.nan_to_num(np.hypot(*(result.camera.project(enu @ attitude.R_cam.T) - uv).T), nan=np.inf)
    return dataclasses.replace(
        outcome, stars=attitude.stars, middle_px=float(np.median(off_px)), largest_px=float(off_px.max()),
        focal_z=(result.camera.f_px - truth.f_px) / result.sigmas["f_px"], seconds=time.perf_counter() - started,
    )  # fmt: skip


def rows_of(outcomes: list[Outcome]) -> list[str]:
    """A row of the table for each camera, and one for all together."""
    by_camera = {name: [one for one in outcomes if one.camera == name] for name in sorted({o.camera for o in outcomes})}
    lines = []
    for name, some in (*by_camera.items(), ("all", outcomes)):
        done = [one for one in some if one.stars]
        cells = [name, f"{len(done)} of {len(some)}"]
        if done:
            middle, largest = [one.middle_px for one in done], [one.largest_px for one in done]
            z = np.array([one.focal_z for one in done])
            seconds = np.median([one.seconds for one in done])
            cells += [f"{np.median(middle):.3f}, {max(middle):.3f}", f"{np.median(largest):.2f}, {max(largest):.2f}"]
            cells += [f"{np.sqrt(np.mean(z**2)):.2f}", f"{seconds:.0f}"]
        else:
            cells += ["-"] * 4
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("truth", type=Path, help="folder of `skybench bench round pack --truth`")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    records = sorted(given.truth.glob("*/frame-?????.json"))
    if not records:
        parser.error(f"{given.truth}: no frames in it")
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        outcomes = list(pool.map(calibrated, records))
    over = "over the frame: median, largest, px"
    print(f"| camera | calibrated | median error {over} | largest error {over} | focal length, sigmas | s |")
    print("|---|---|---|---|---|---|")
    print("\n".join(rows_of(outcomes)))
    for one in outcomes:
        if not one.stars or one.largest_px > 1.0:
            what = one.refusal or f"{one.largest_px:.2f} px with {one.stars} stars"
            print(f"{one.frame} ({one.camera}, {one.detections} detections): {what}")


if __name__ == "__main__":
    main()
