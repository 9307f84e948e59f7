"""Combine photographs of a fixed camera: python tools/real_night.py FRAMES --camera FILE --site LAT LON HEIGHT.

Frames and the camera's file are those of `celnav calibrate`; the attitude in the file is supplied for every frame. The site
is used to print errors, and its height for the air.
"""

from __future__ import annotations

import argparse

import numpy as np

import celnav
from benchmark.judge.geodesy import east_north_km
from celnav.command.calibration_frames import read_frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("frames", nargs="+")
    parser.add_argument("--camera", required=True)
    parser.add_argument("--site", type=float, nargs=3, required=True, metavar=("LAT", "LON", "HEIGHT"))
    arguments = parser.parse_args()
    lat, lon, height_m = arguments.site
    air = celnav.usual_weather(height_m)
    night = celnav.Night(
        celnav.read_camera_file(arguments.camera).camera, celnav.Attitude.from_json(arguments.camera),
        pressure_hpa=air.pressure_hpa, temperature_c=air.temperature_c,
    )  # fmt: skip
    frames = read_frames(arguments.frames)
    for frame in frames:
        night.add(frame.detections, frame.utc)
    found = night.fix()
    single = []
    for number, (frame, fix) in enumerate(zip(frames, night.fixes, strict=True)):
        said = str(fix.reason)
        if fix.ok:
            single.append(float(np.hypot(*east_north_km(lat, lon, fix.lat_deg, fix.lon_deg))))
            said = f"{single[-1]:.2f} km, {len(fix.matches)} stars"
        print(f"{number:3d} {frame.name:45s} {said}")
    print(f"single fixes: median {np.median(single):.2f} km" if single else "no single fix")
    if found.ok and found.cov_km2 is not None:
        error = np.array(east_north_km(lat, lon, found.lat_deg, found.lon_deg))
        sigmas = " x ".join(f"{one:.2f}" for one in np.sqrt(np.diag(found.cov_km2)))
        nees = float(error @ np.linalg.solve(found.cov_km2, error))
        print(f"night: {np.hypot(*error):.2f} km, stated {sigmas} km, NEES {nees:.2f}")
        print(f"latitude by the axis: {found.latitude_deg}")
    else:
        print(f"night: {found.reason}, {found.message}")
    print("told:", *found.told, sep="\n  ")
    print("untold:", *found.untold, sep="\n  ")


if __name__ == "__main__":
    main()
