"""A gyroscope carries the attitude from frame to frame: what its errors do to the position of a fix.

A position from stars is as good as the vertical that it is given: an arc minute of tilt is 1.9 km. Here the attitude is
known at the first frame, and integrated from there by the readings of a small gyroscope, whose bias of some 20 deg/h
about each axis tilts it more and more. The same stars, solved with the true attitude, show what the camera would allow.

    skybench render sequence --out out/sequence
    python examples/carried_attitude.py out/sequence
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

import celnav

EARTH_RAD_S = 7.292115e-5


def carried(R_cam: np.ndarray, rates: np.ndarray, step_s: float, latitude_deg: float) -> np.ndarray:
    """Attitude (east-north-up to camera) after steps with body rates against inertial space, (n, 3) in rad/s.

    The Earth's rotation is taken off; the turn of the vertical along the way, 0.5 arcmin per km, is left out.
    """
    latitude = math.radians(latitude_deg)
    earth_enu = EARTH_RAD_S * np.array([0.0, math.cos(latitude), math.sin(latitude)])
    attitude = Rotation.from_matrix(R_cam)
    for rate in rates:
        attitude = Rotation.from_rotvec(-(rate - attitude.apply(earth_enu)) * step_s) * attitude
    return attitude.as_matrix()


def error_km(fix: celnav.Fix, site: dict[str, float]) -> float:
    """Distance of a fix from the truth on a sphere."""
    north = math.radians(fix.lat_deg - site["latitude_deg"])
    east = math.radians(fix.lon_deg - site["longitude_deg"]) * math.cos(math.radians(site["latitude_deg"]))
    return 6371.0 * math.hypot(north, east)


def sequences(folder: Path) -> dict[int, list[Path]]:
    """Frame records of a rendered folder by sequence, in order of time; ends the program where there are none."""
    found: dict[int, list[tuple[int, Path]]] = {}
    for path in folder.glob("frame-*.json"):
        place = json.loads(path.read_text()).get("sequence")
        if place:
            found.setdefault(place["index"], []).append((place["step"], path))
    if not found or not (folder / "imu.parquet").is_file():
        raise SystemExit(
            f"{folder}: has no frames of sequences with an imu.parquet; skybench render writes such a folder"
        )
    return {number: [path for _, path in sorted(found[number])] for number in sorted(found)}


def main(folder: Path) -> None:
    """Print, for each frame of each sequence, the error of the carried attitude and of both fixes."""
    found = sequences(folder)
    for number, records in found.items():
        if len(found) > 1:
            print(f"sequence {number}")
        show(records, pq.read_table(folder / "imu.parquet", filters=[("sequence", "=", number)]))


def show(records: list[Path], readings: pa.Table) -> None:
    """Print the lines of one sequence, whose inertial unit has given the readings."""
    first = json.loads(records[0].read_text())
    time_s = readings["t_s"].to_numpy()
    rates = np.stack([readings[f"gyro_{axis}_rad_s"].to_numpy() for axis in "xyz"], axis=1)
    step_s = float(time_s[1] - time_s[0])

    attitude, latitude_deg = np.array(first["attitude"]["R_cam"]), first["site"]["latitude_deg"]
    now_s = first["sequence"]["start_s"] + first["time"]["exposure_s"] / 2
    print("time, s   attitude off, arcmin   fix off, km   with the true attitude, km")
    for path in records:
        record = json.loads(path.read_text())
        middle_s = record["sequence"]["start_s"] + record["time"]["exposure_s"] / 2
        since = (time_s > now_s + step_s / 2) & (time_s < middle_s + step_s / 2)
        attitude, now_s = carried(attitude, rates[since], step_s, latitude_deg), middle_s
        true = np.array(record["attitude"]["R_cam"])
        off_arcmin = math.degrees(Rotation.from_matrix(attitude @ true.T).magnitude()) * 60

        detections = celnav.detect(celnav.read_image(path.with_suffix(".png")))
        camera, time = celnav.Camera.from_json(path), record["time"]
        fixes = [
            celnav.solve(
                detections, camera, utc=time["utc_mid"], attitude=celnav.Attitude.exact(R_cam), dut1_s=time["ut1_utc_s"]
            )
            for R_cam in (attitude, true)
        ]
        off_km = [f"{error_km(fix, record['site']):.2f}" if fix.ok else fix.reason for fix in fixes]
        print(f"{middle_s:7.1f}   {off_arcmin:20.2f}   {off_km[0]:>11}   {off_km[1]:>26}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(f"usage: python {sys.argv[0]} DIR")
    main(Path(sys.argv[1]))
