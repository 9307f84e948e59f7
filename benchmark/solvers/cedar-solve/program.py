"""cedar-solve behind docs/solver_protocol.md; runs in its own environment (requirements.txt), without skybench.

Fields up to 30 deg are solved with the database that comes with it. Databases for wider fields are built on first use from
the Yale Bright Star Catalogue that comes with skybench, which takes half a minute, and kept in the user's cache.
`python program.py make` builds them beforehand, since an isolated program cannot keep them.
"""

import json
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

PROTOCOL = "skybench-solver/1"
VERSION = "0.5.1"
BSC = Path(__file__).parents[3] / "celnav" / "data" / "ybsc" / "catalog.dat"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skybench" / "cedar-solve"
DATABASE_FOVS_DEG = (45.0, 60.0, 90.0, 120.0)
WIDEST_OF_DEFAULT_DEG = 30.0
FOV_MAX_ERROR_DEG = 5.0
MARGIN, LEAST_MARGIN_S = 0.1, 0.3
"""Share and least amount (s) of a request's time that are reserved for the last pattern and for the answer."""
EXTRACTION: dict[str, Any] = {}
"""Settings of its detector that differ from the defaults; docs/rivals.md reports the trials."""


def write_bsc5(path: Path) -> None:
    """Write the catalogue in the byte format of the SAO's BSC5 file, which tetra3 reads (29 bytes of header, 32 per star)."""
    rows = []
    for line in BSC.read_text(encoding="ascii", errors="replace").splitlines():
        line = line.ljust(197)
        if not line[75:83].strip() or not line[102:107].strip():
            continue
        ra = math.radians(15 * (int(line[75:77]) + int(line[77:79]) / 60 + float(line[79:83]) / 3600))
        dec = math.radians(int(line[84:86]) + int(line[86:88]) / 60 + int(line[88:90]) / 3600)
        motion = [math.radians(float(text or 0) / 3600) for text in (line[148:154].strip(), line[154:160].strip())]
        sign = -1 if line[83] == "-" else 1
        rows.append((int(line[0:4]), ra, sign * dec, 0, round(100 * float(line[102:107])), *motion))
    layout = "f4,f8,f8,i2,i2,f4,f4"
    header = np.array([0, 0, -len(rows), 1, 1, 1, 32], dtype=np.int32)
    path.write_bytes(header.tobytes() + np.array(rows, dtype=layout).tobytes())


def load_database(tetra3: Any, fov_deg: float) -> Any:
    """Load the database of patterns for fields of view up to this one; build it where it does not exist yet."""
    name = CACHE / f"bsc5-{fov_deg:g}-deg-{VERSION.replace('.', '-')}"  # a dot would start a suffix
    if not name.with_suffix(".npz").exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        catalogue = CACHE / "bsc5"
        write_bsc5(catalogue)
        maker = tetra3.Tetra3(load_database=None)
        maker.generate_database(
            max_fov=fov_deg + FOV_MAX_ERROR_DEG,
            save_as=str(name),
            star_catalog=str(catalogue),
            epoch_proper_motion=2020,
        )
    return tetra3.Tetra3(load_database=str(name))


def rotation_of(found: dict[str, float]) -> Any:
    """Rotation from ICRS to camera (x right, y down, z boresight), from tetra3's right ascension, declination and roll."""
    ra, dec, roll = (math.radians(found[key]) for key in ("RA", "Dec", "Roll"))
    boresight = np.array([math.cos(ra) * math.cos(dec), math.sin(ra) * math.cos(dec), math.sin(dec)])
    east = np.array([-math.sin(ra), math.cos(ra), 0.0])
    north = np.cross(boresight, east)
    left = math.cos(roll) * east + math.sin(roll) * north
    up = -math.sin(roll) * east + math.cos(roll) * north
    return np.array([-left, -up, boresight])


def answer(tetra3: Any, databases: dict[float, Any], request: dict[str, Any]) -> dict[str, Any]:
    """Detect, solve, and convert the answer to the protocol's terms."""
    camera = request["camera"]
    started = time.perf_counter()
    own = request["detections"] is None
    if own:
        with Image.open(request["image"]) as picture:
            image = np.asarray(picture).astype(np.float32)
        # tetra3 counts from the corner of the first pixel, row before column.
        centroids = np.asarray(tetra3.get_centroids_from_image(image, **EXTRACTION)).reshape(-1, 2)
        uv = centroids[:, ::-1] - 0.5
    else:
        uv = np.array(request["detections"]["uv"], dtype=float).reshape(-1, 2)
    detected = time.perf_counter()
    result: dict[str, Any] = {
        "detections": {"uv": uv.tolist(), "flux": None} if own else None,
        "time_ms": {"detect": 1000 * (detected - started)},
    }
    if len(uv) < 4:
        return result | {"status": "refused", "reason": "fewer than 4 detections"}
    fov = math.degrees(2 * math.atan(camera["width"] / 2 / camera["f_px"]))
    database = database_for(databases, fov)
    # It verifies with this number of brightest stars; a pattern with a fainter one would exceed them (IndexError).
    brightest = uv[: database.database_properties["verification_stars_per_fov"]]
    # With `lens: pinhole` the principal point is in the middle, as tetra3 assumes. The row comes before the column.
    found = database.solve_from_centroids(
        brightest[:, ::-1] + 0.5, (camera["height"], camera["width"]), fov_estimate=fov,
        fov_max_error=FOV_MAX_ERROR_DEG, solve_timeout=1000 * search_time_s(request["time_limit_s"], started),
        return_matches=True,
    )  # fmt: skip
    if found["RA"] is None:
        return result | {"status": "refused", "reason": "no match"}
    return result | {
        "status": "attitude",
        "R_icrs_to_camera": rotation_of(found).tolist(),
        "confidence": min(max(1.0 - float(found["Prob"]), 0.0), 1.0),
        "match_directions": matches_of(found, uv),
    }


def search_time_s(limit_s: float, started: float) -> float:
    """Time for the search within a request that began at the given reading of `time.perf_counter`."""
    return max(limit_s - max(MARGIN * limit_s, LEAST_MARGIN_S) - (time.perf_counter() - started), 0.0)


def database_for(databases: dict[float, Any], fov_deg: float) -> Any:
    """Database with the smallest field that is not smaller than this one; if all are smaller, the one with the largest."""
    return databases[min((known for known in databases if known >= fov_deg), default=max(databases))]


def matches_of(found: dict[str, Any], uv: Any) -> list[list[float]]:
    """Indices of the matched detections, with right ascension and declination of their stars, degrees."""
    matches = []
    for (y, x), (ra, dec, _) in zip(found["matched_centroids"], found["matched_stars"], strict=True):
        row = int(np.argmin(np.hypot(uv[:, 0] + 0.5 - x, uv[:, 1] + 0.5 - y)))
        matches.append([row, float(ra), float(dec)])
    return matches


def main() -> None:
    """Answer requests over standard input and output."""
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    import tetra3

    databases = {WIDEST_OF_DEFAULT_DEG: tetra3.Tetra3()}
    databases |= {fov: load_database(tetra3, fov) for fov in DATABASE_FOVS_DEG}
    if sys.argv[1:] == ["make"]:
        return
    for line in sys.stdin:
        request = json.loads(line)
        if request["type"] == "hello":
            reply = {"type": "hello", "protocol": PROTOCOL, "name": "cedar-solve", "version": VERSION}
        else:
            try:
                reply = answer(tetra3, databases, request)
            except Exception as error:  # any exception costs it only this frame
                reply = {"status": "error", "reason": f"{type(error).__name__}: {error}"}
            reply |= {"type": "fix", "frame_id": request["frame_id"]}
        print(json.dumps(reply), file=replies, flush=True)


if __name__ == "__main__":
    main()
