"""Processor time of detection and solution on photographs: python tools/real_times.py FRAMES --camera FILE [--height-m 2361].

Frames and the camera's file are those of `celnav calibrate`. Each time is the least of several on one thread, and is also
given as a multiple of the calibration loop of `skybench speed --solver`; run it with OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import celnav
from benchmark.fields.solver_effort import calibration_s
from celnav.reading.fits_file import read_fits


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("frames", nargs="+")
    parser.add_argument("--camera", required=True)
    parser.add_argument("--height-m", type=float, default=0.0)
    parser.add_argument("--repeat", type=int, default=7)
    arguments = parser.parse_args()
    camera = celnav.read_camera_file(arguments.camera).camera
    attitude = celnav.Attitude.from_json(arguments.camera)
    air = celnav.usual_weather(arguments.height_m)
    loop_s = calibration_s()
    print("| frame | detections | detection, ms | image to fix, ms | loops | outcome |\n|-|-|-|-|-|-|")
    for path in arguments.frames:
        frame = read_fits(path)
        if frame.exposure.middle is None:
            parser.error(f"{path} does not say when it was taken")
        detecting, together = [], []
        for _ in range(arguments.repeat):
            begun = time.thread_time()
            found = celnav.detect(frame.pixels)
            detecting.append(time.thread_time() - begun)
            fix = celnav.solve(
                found,
                camera,
                frame.exposure.middle,
                attitude,
                pressure_hpa=air.pressure_hpa,
                temperature_c=air.temperature_c,
            )
            together.append(time.thread_time() - begun)
        name, best = Path(path).name.split(".")[0], min(together)
        print(
            f"| {name} | {len(found)} | {1e3 * min(detecting):.0f} | {1e3 * best:.0f} | {best / loop_s:.1f} | {fix.reason} |"
        )
    print(f"\na loop: {1e3 * loop_s:.1f} ms; load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
