"""One set of detections for all solvers: celnav's detector with its default settings."""

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from threading import Lock

import celnav
from benchmark.frames.dataset import Frame, load_image
from benchmark.protocol import Detections
from benchmark.solvers.revision import installed_packages

SHARED_DETECTIONS = "shared-detections"
"""Name under which a round's commitment states the detector's revision."""


def shared_detector() -> str:
    """Name of the shared detector, with its revision."""
    return f"celnav-{installed_packages().detector_revision}"


MOST_KEPT_POINTS = 5_000_000
"""Most points that are kept, at most 56 bytes each: more than any task of skybench has."""
_POINTS_OF_EMPTY = 20
"""What a frame counts besides its points, so that frames without any are bounded too."""


class KeptDetections:
    """Detections by image, for the solvers to come; the longest unused are dropped where they would be too many points.

    Parameters
    ----------
    most_points : int
    """

    def __init__(self, most_points: int) -> None:
        self._most = most_points
        self._points = 0
        self._found: OrderedDict[Path, Detections] = OrderedDict()
        self._lock = Lock()

    def of(self, path: Path, detect: Callable[[], Detections]) -> Detections:
        """Detections of an image, which are made where they are not there."""
        with self._lock:
            if path in self._found:
                self._found.move_to_end(path)
                return self._found[path]
        made = detect()
        with self._lock:
            if path not in self._found:
                self._found[path] = made
                self._points += _count(made)
            while self._points > self._most:
                self._points -= _count(self._found.popitem(last=False)[1])
        return made


def _count(found: Detections) -> int:
    return _POINTS_OF_EMPTY + len(found.uv)


_kept = KeptDetections(MOST_KEPT_POINTS)


def shared_detections(frame: Frame) -> Detections:
    """Detect stars in a frame's image, or take those that were found before, for another solver."""

    def detect() -> Detections:
        found: Detections = celnav.detect(load_image(frame))
        return found

    return _kept.of(frame.image_path, detect)
