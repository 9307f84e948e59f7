"""Hashes of images' pixels, remembered by the hashes of their files, so that an image is decoded for its hash only once.

The hashes are lines of a text file in the user's cache. Each line is appended by one write, so that processes can share the
file. Without it everything takes longer, and nothing else changes.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
from pathlib import Path

from benchmark.errors import DatasetError
from benchmark.frames.dataset import Frame, load_image
from benchmark.frames.record_values import RENDER_AGAIN
from celnav.cache import cache_dir
from generator.identity.pixels import pixels_sha256

LARGEST_FILE_BYTES = 64 << 20
"""A file of this size, some 440,000 images, is begun anew."""
_LINE = re.compile(r"([0-9a-f]{64}:[0-9]+x[0-9]+) ([0-9a-f]{64})")


def image_sha256(frame: Frame) -> str:
    """SHA-256 of the pixels of a frame's image (`generator.identity.pixels`).

    Raises
    ------
    DatasetError
        The image is missing or damaged, or its size is not that of the frame's camera.
    """
    path, camera = frame.image_path, frame.observation.camera
    try:
        with path.open("rb") as file:
            name = f"{hashlib.file_digest(file, 'sha256').hexdigest()}:{camera.width}x{camera.height}"
    except OSError as error:
        raise DatasetError(f"{path}: missing image; {RENDER_AGAIN}") from error
    place = _place()
    known = {} if place is None else _read(place)
    if name not in known:
        known[name] = pixels_sha256(load_image(frame))
        if place is not None:
            _append(place, f"{name} {known[name]}\n")
    return known[name]


def _place() -> Path | None:
    """The file of hashes; None where there is no home folder."""
    try:
        return cache_dir().with_name("pixel_hashes.txt")
    except RuntimeError:
        return None


@functools.lru_cache(maxsize=1)
def _read(place: Path) -> dict[str, str]:
    """Hashes of pixels by the hash of the file and the size of the image; lines of another form are ignored."""
    with contextlib.suppress(OSError):
        if place.stat().st_size <= LARGEST_FILE_BYTES:
            lines = place.read_text("ascii", "replace").splitlines()
            return {found[1]: found[2] for found in map(_LINE.fullmatch, lines) if found}
        place.unlink()
    return {}


def _append(place: Path, line: str) -> None:
    with contextlib.suppress(OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(place, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        try:
            os.write(handle, line.encode("ascii"))
        finally:
            os.close(handle)
