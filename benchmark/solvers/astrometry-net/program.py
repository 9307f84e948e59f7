"""astrometry.net behind docs/solver_protocol.md: the system's ``solve-field`` with Debian's Tycho-2 indexes.

Supplied detections are passed on as a list of positions; without them it detects in the image by itself (image2xy). Of frames
wider than 30 deg it receives the middle 30 deg, because it compares the shapes of quads on planes, which wide fields distort.
"""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from astropy.wcs import WCS, FITSFixedWarning
from PIL import Image

PROTOCOL = "skybench-solver/1"
INDEXES = Path("/usr/share/astrometry")
INSTALL = "apt-get install -y astrometry.net astrometry-data-tycho2"
SCALE_ERROR = 0.06
"""Relative tolerance around the supplied field, to both sides; frames with a larger error of the focal length are retried."""
MARGIN, LEAST_MARGIN_S = 0.1, 1.0
"""Share and least amount (s) of a request's time that are reserved for the answer."""
SETTINGS = [
    "--no-plots",
    "--overwrite",
    "--no-tweak",
    "--parity",
    "pos",
    "--crpix-center",
    "--objs",
    "100",
    "--depth",
    "30,60,100",
    "--code-tolerance",
    "0.03",
    "--pixel-error",
    "2",
]
MOST_DETECTIONS = 300
WIDEST_DEG = 30.0


def version_of_program() -> str:
    """Version of the installed program; exits with a message that says what to do where it is missing."""
    if shutil.which("solve-field") is None:
        sys.exit(f"astrometry-net: solve-field is not installed; on Debian and Ubuntu: {INSTALL}")
    if not any(INDEXES.glob("index-tycho2-*.fits")):
        sys.exit(f"astrometry-net: {INDEXES} holds no index of Tycho-2; on Debian and Ubuntu: {INSTALL}")
    said = subprocess.run(["solve-field", "--version"], capture_output=True, text=True, check=True).stdout
    return said.split()[-1].split("-")[0].split(",")[0]


def middle_of(camera: dict[str, Any]) -> tuple[dict[str, Any], tuple[int, int]]:
    """Camera of the frame's middle, at most `WIDEST_DEG` wide and high, and the position of its first pixel in the frame."""
    most = 2 * camera["f_px"] * math.tan(math.radians(WIDEST_DEG / 2))
    corner = tuple(max(0, math.ceil((camera[side] - most) / 2)) for side in ("width", "height"))
    size = {side: camera[side] - 2 * first for side, first in zip(("width", "height"), corner, strict=True)}
    return camera | size, corner


def write_detections(uv: Any, path: Path) -> None:
    """Write positions by the FITS convention, counted from 1, the brightest first."""
    columns = [fits.Column(name, "E", array=uv[:MOST_DETECTIONS, axis] + 1.0) for axis, name in enumerate("XY")]
    fits.BinTableHDU.from_columns(columns).writeto(path)


def solve(request: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run the program in an empty folder, and convert its answer to the protocol's terms."""
    started = time.perf_counter()
    camera, corner = middle_of(request["camera"])
    # It measures a field by the scale in its middle times its width, as if it were flat.
    width_deg = math.degrees(camera["width"] / camera["f_px"])
    (folder / "config").write_text(f"add_path {INDEXES}\nautoindex\nminwidth 0.1\nmaxwidth 180\n")
    own = request["detections"] is None
    if own:
        with Image.open(request["image"]) as picture:
            pixels = np.asarray(picture).astype(np.int32)
        rows, columns = (
            slice(corner[axis], corner[axis] + camera[side]) for axis, side in ((1, "height"), (0, "width"))
        )
        fits.PrimaryHDU(pixels[rows, columns]).writeto(folder / "field.fits")
        source = ["field.fits", "--keep-xylist", "found.xyls"]
    else:
        uv = np.array(request["detections"]["uv"], dtype=float).reshape(-1, 2) - corner
        inside = ((uv > -0.5) & (uv < [camera["width"] - 0.5, camera["height"] - 0.5])).all(axis=1)
        if inside.sum() < 4:
            return {"status": "refused", "reason": "fewer than 4 detections"}
        write_detections(uv[inside], folder / "field.xyls")
        size = ["--width", str(camera["width"]), "--height", str(camera["height"])]
        source = ["field.xyls", *size, "--x-column", "X", "--y-column", "Y"]
    command = [
        "solve-field", *source, *SETTINGS, "--config", "config", "--temp-dir", str(folder), "--dir", str(folder),
        "--scale-units", "degwidth",
        "--scale-low", str(width_deg * (1.0 - SCALE_ERROR)), "--scale-high", str(width_deg * (1.0 + SCALE_ERROR)),
    ]  # fmt: skip
    failure = run_within(search_time_s(request["time_limit_s"], started), command, folder)
    answer: dict[str, Any] = {}
    if own:
        uv = read_detections(folder / "found.xyls")
        answer["detections"] = {"uv": (uv + corner).tolist(), "flux": None}
    if not (folder / "field.wcs").is_file():
        if failure:
            return answer | {"status": "error", "reason": failure}
        return answer | {"status": "refused", "reason": "did not solve"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)  # its header has axes but no image
        wcs = WCS(fits.getheader(folder / "field.wcs"))
    return answer | {
        "status": "attitude",
        "confidence": probability_of(folder / "field.match"),
        "R_icrs_to_camera": rotation_of(wcs, camera).tolist(),
        "match_directions": read_matches(folder / "field.corr", uv),
    }


def search_time_s(limit_s: float, started: float) -> float:
    """Time for the search within a request that began at the given reading of `time.perf_counter`."""
    return max(limit_s - max(MARGIN * limit_s, LEAST_MARGIN_S) - (time.perf_counter() - started), 0.0)


def run_within(limit_s: float, command: list[str], folder: Path) -> str:
    """Run a command and end it, with everything that it has started, at the limit; returns why it failed, or nothing.

    The program's own limit counts processor time, which on a busy machine lasts longer than a frame may take.
    """
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        _, words = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return ""
    return (words.strip().splitlines() or ["failed"])[-1][:150] if process.returncode else ""


def read_detections(path: Path) -> Any:
    """Read the program's own detections, the brightest first, shape (n, 2)."""
    if not path.is_file():
        return np.empty((0, 2))
    table = fits.getdata(path, 1)
    return np.column_stack((table["X"], table["Y"])).astype(float)[:MOST_DETECTIONS] - 1.0


def probability_of(path: Path) -> float:
    """Probability of the solution: the program states the logarithm of its odds against a match by chance."""
    (log_odds,) = fits.getdata(path, 1)["LOGODDS"][:1]
    return 1.0 / (1.0 + math.exp(-float(log_odds)))


def read_matches(path: Path, uv: Any) -> list[list[float]]:
    """Read the indices of the matched detections, with the places of their stars."""
    if not path.is_file() or not len(uv):
        return []
    table = fits.getdata(path, 1)
    matches: dict[int, list[float]] = {}
    for x, y, ra, dec in zip(table["field_x"], table["field_y"], table["index_ra"], table["index_dec"], strict=True):
        off = np.hypot(uv[:, 0] + 1.0 - x, uv[:, 1] + 1.0 - y)
        row = int(np.argmin(off))
        if off[row] < 0.1:
            matches.setdefault(row, [row, float(ra), float(dec)])
    return list(matches.values())


def rotation_of(wcs: Any, camera: dict[str, Any]) -> Any:
    """Rotation from ICRS to camera (x right, y down, z boresight) that best fits the solution over the frame."""
    u, v = (
        axis.ravel() for axis in np.meshgrid(*(np.linspace(0, camera[side] - 1, 9) for side in ("width", "height")))
    )
    ra, dec = np.radians(wcs.all_pix2world(u, v, 0))
    sky = np.column_stack((np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)))
    # Directions use the scale of the solution, because the supplied scale may be off.
    (scale,) = np.sqrt(np.abs(np.linalg.det(wcs.pixel_scale_matrix)))[None]
    f_px = 1.0 / math.radians(scale)
    x, y = (u - (camera["width"] - 1) / 2) / f_px, (v - (camera["height"] - 1) / 2) / f_px
    seen = np.column_stack((x, y, np.ones(len(x))))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    left, _, right = np.linalg.svd(seen.T @ sky)
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def main() -> None:
    """Answer requests over standard input and output."""
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    version = version_of_program()
    for line in sys.stdin:
        request = json.loads(line)
        reply: dict[str, Any]
        if request["type"] == "hello":
            reply = {"type": "hello", "protocol": PROTOCOL, "name": "astrometry-net", "version": version}
        else:
            started = time.perf_counter()
            with tempfile.TemporaryDirectory() as folder:
                try:
                    reply = solve(request, Path(folder))
                except Exception as error:  # any exception costs it only this frame
                    reply = {"status": "error", "reason": f"{type(error).__name__}: {error}"}
            reply |= {"type": "fix", "frame_id": request["frame_id"]}
            reply["time_ms"] = {"all": 1000.0 * (time.perf_counter() - started)}
        print(json.dumps(reply), file=replies, flush=True)


if __name__ == "__main__":
    main()
