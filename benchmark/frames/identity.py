"""Identity of a frame: the hashes of its image and of its truth, by which results identify their frames."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from benchmark.frames.dataset import Frame
from benchmark.frames.pixel_hashes import image_sha256


@dataclass(frozen=True)
class FrameIdentity:
    """Hashes of a frame, each of 64 hexadecimal digits; None where unknown.

    Attributes
    ----------
    image_sha256 : str or None
        Hash of the pixels, see `generator.identity.pixels`.
    truth_sha256 : str or None
        Hash of the place and the stars, see `truth_sha256_of`.
    """

    image_sha256: str | None
    truth_sha256: str | None

    def contradicts(self, other: FrameIdentity) -> bool:
        """Whether the two cannot belong to the same frame; unknown hashes contradict nothing."""
        pairs = ((self.image_sha256, other.image_sha256), (self.truth_sha256, other.truth_sha256))
        return any(mine is not None and theirs is not None and mine != theirs for mine, theirs in pairs)


UNKNOWN = FrameIdentity(None, None)


def identity_of(frame: Frame) -> FrameIdentity:
    """Hash a frame's image and its truth; a frame that was created in memory has no image.

    Raises
    ------
    DatasetError
        The image is missing or damaged.
    """
    image = image_sha256(frame) if frame.image_path.name else None
    return FrameIdentity(image, truth_sha256_of(frame))


def truth_sha256_of(frame: Frame) -> str:
    """SHA-256 of a frame's site and stars, independent of its name and of the files that hold them."""
    place, truth = (frame.conditions.latitude_deg, frame.conditions.longitude_deg), frame.truth
    digest = hashlib.sha256(f"skybench-truth/1:{place!r}:{len(truth.star_id)}:".encode())
    light = () if truth.light_uv is None else (truth.light_uv,)
    for values in (truth.star_id, truth.uv, truth.electrons_e, truth.snr, *light):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
