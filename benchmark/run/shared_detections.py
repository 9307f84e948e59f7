"""One set of detections for all solvers: celnav's detector with its default settings."""

import hashlib
from functools import lru_cache
from pathlib import Path

import celnav
from benchmark.frames.dataset import Frame, load_image
from benchmark.protocol import Detections

DETECTOR_CODE = ("detection", "flood_fill", "image_background", "star_candidates", "star_centroids", "star_shape")


@lru_cache(maxsize=1)
def shared_detector() -> str:
    """Name of the shared detector, with a digest of its code."""
    package = Path(celnav.__file__).parent
    code = b"".join((package / f"{module}.py").read_bytes() for module in DETECTOR_CODE)
    return f"celnav-{hashlib.sha256(code).hexdigest()[:12]}"


def shared_detections(frame: Frame) -> Detections:
    """Detect in a frame's image."""
    return _detect(frame.image_path, frame)


# Solvers come to the same frames one after another, and levels of one task share their images.
_kept: dict[Path, Detections] = {}


def _detect(path: Path, frame: Frame) -> Detections:
    if path not in _kept:
        found: Detections = celnav.detect(load_image(frame))
        _kept[path] = found
    return _kept[path]
