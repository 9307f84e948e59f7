"""Stretched 8-bit pictures of frames for the report."""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

MAX_WIDTH_PX = 1080
_QUALITY = 60


def stretch(image: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Map stars and sky of one frame to 8 bits with an asinh curve.

    Black is two standard deviations of the sky below its median (the deviation is derived from the median absolute
    deviation), the knee of the curve is four above, and white is at the 99.97th percentile. The stretch adapts to each frame,
    so brightness must not be compared between frames.

    Parameters
    ----------
    image : ndarray of uint16, shape (height, width)
        DN.

    References
    ----------
    R. Lupton et al., PASP 116, 133-137, 2004 (asinh stretch).
    """
    values = image.astype(np.float64)
    median = float(np.median(values))
    sigma = max(1.4826 * float(np.median(np.abs(values - median))), 1.0)
    black, knee = median - 2.0 * sigma, 4.0 * sigma
    white = max(float(np.percentile(values, 99.97)), median + 4.0 * sigma)
    curve = np.arcsinh(np.clip(values - black, 0.0, None) / knee) / np.arcsinh((white - black) / knee)
    grey: NDArray[np.uint8] = np.round(255.0 * np.clip(curve, 0.0, 1.0)).astype(np.uint8)
    return grey


def preview_webp(image: NDArray[np.uint16], max_width_px: int = MAX_WIDTH_PX) -> bytes:
    """Encode a frame as a stretched WebP picture, reduced to `max_width_px` where it is wider."""
    return encode_webp(Image.fromarray(stretch(image)), max_width_px)


def encode_webp(picture: Image.Image, max_width_px: int) -> bytes:
    """Encode a grey picture as WebP, reduced to `max_width_px` where it is wider."""
    if picture.width > max_width_px:
        height = max(1, round(picture.height * max_width_px / picture.width))
        picture = picture.resize((max_width_px, height), Image.Resampling.BOX, reducing_gap=None)
    stream = io.BytesIO()
    picture.convert("RGB").save(stream, format="WEBP", quality=_QUALITY, method=4)
    return stream.getvalue()
