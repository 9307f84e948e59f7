"""The hash of an image's pixels, independent of the file that contains them."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray


def pixels_sha256(image: NDArray[np.uint8] | NDArray[np.uint16]) -> str:
    """SHA-256 of an image's values with their type and shape.

    It is the same for every file with these pixels: compression, chunks and metadata do not count.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, shape (height, width) or (height, width, channels)

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    little = np.ascontiguousarray(image, dtype=image.dtype.newbyteorder("<"))
    shape = "x".join(str(length) for length in image.shape)
    digest = hashlib.sha256(f"skybench-pixels/1:{image.dtype.itemsize}:{shape}:".encode())
    digest.update(little.tobytes())
    return digest.hexdigest()
