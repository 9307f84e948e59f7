"""One set of detections for all solvers: celnav's detector with its default settings."""

from pathlib import Path

import celnav
from benchmark.frames.dataset import Frame, load_image
from benchmark.protocol import Detections
from benchmark.solvers.revision import installed_packages

SHARED_DETECTIONS = "shared-detections"
"""Name under which a round's commitment states the detector's revision."""


def shared_detector() -> str:
    """Name of the shared detector, with its revision."""
    return f"celnav-{installed_packages().detector_revision}"


def shared_detections(frame: Frame) -> Detections:
    """Detect stars in a frame's image."""
    return _detect(frame.image_path, frame)


# Solvers process the same frames one after another, and the levels of one task share their images.
_kept: dict[Path, Detections] = {}


def _detect(path: Path, frame: Frame) -> Detections:
    if path not in _kept:
        found: Detections = celnav.detect(load_image(frame))
        _kept[path] = found
    return _kept[path]
