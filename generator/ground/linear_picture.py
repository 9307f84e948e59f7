"""OpenEXR pictures of linear light as landscapes: their header is checked before they are decoded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.ground.panorama import MOST_TEXELS, Bytes, encoded
from generator.ground.picture import PictureError

Singles = NDArray[np.float32]

MOST_CHANNELS = 4
DAMAGED = (OSError, RuntimeError, TypeError, KeyError, ValueError, IndexError, OverflowError)
"""Exceptions that OpenEXR raises for files that it cannot read."""


@dataclass(frozen=True, eq=False)
class LinearPicture:
    """A picture of linear values.

    Attributes
    ----------
    rgba : (height, width, 4) uint8 array
        Values divided by `white`, encoded in sRGB, and alpha.
    white : float
        Linear value of its white.
    """

    rgba: Bytes
    white: float


def read_linear(location: Path, name: str, most: float | None) -> LinearPicture:
    """Read an OpenEXR picture with the channels R, G, B (or Y) and, if there is transparency, A.

    Colours are premultiplied by alpha, as the format specifies; without A the picture is opaque.

    Parameters
    ----------
    location : Path
    name : str
        Name of the file in the scenario.
    most : float or None
        Larger values are limited to this; None makes the largest value in the picture white.

    Raises
    ------
    PictureError
        The picture is damaged, too large, has negative or non-finite values, or is an unsupported kind of OpenEXR.
    """
    import OpenEXR

    try:
        with OpenEXR.File(str(location), separate_channels=True, header_only=True) as file:
            # The library decodes all parts, whatever the first one says.
            if len(file.parts) != 1:
                raise PictureError(
                    f"'{name}' has {len(file.parts)} parts, expected one picture; save it as a single part"
                )
            _check(file.header(), name, OpenEXR)
        with OpenEXR.File(str(location), separate_channels=True) as file:
            found = {
                key: np.asarray(channel.pixels, np.float32)
                for key, channel in file.channels().items()
                if key in "RGBAY"
            }
    except PictureError:
        raise
    except DAMAGED as error:
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise PictureError(f"'{name}' cannot be read as OpenEXR ({reason})") from error
    colours = [found[key] for key in ("RGB" if found.keys() >= {"R", "G", "B"} else "YYY")]
    alpha = found.get("A", np.ones_like(colours[0]))
    values = np.stack([*colours, alpha], axis=-1)
    if not np.isfinite(values).all() or values.min() < 0:
        raise PictureError(f"'{name}': found values that are negative or not finite, expected linear light from 0 up")
    alpha = np.clip(alpha, 0, 1)
    colour = values[..., :3]
    if "A" in found:
        colour = np.divide(colour, alpha[..., None], out=np.zeros_like(colour), where=alpha[..., None] > 0)
    white = max(float(colour.max()), 1e-30) if most is None else most
    whole = np.rint(255 * alpha).astype(np.uint8)
    return LinearPicture(np.concatenate([encoded(colour / white), whole[..., None]], axis=-1), white)


def _check(header: dict[str, Any], name: str, library: Any) -> None:
    """Check a header."""
    (left, top), (right, bottom) = (tuple(int(edge) for edge in corner) for corner in header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if width * height > MOST_TEXELS:
        raise PictureError(f"'{name}' has {width} x {height} pixels; at most {MOST_TEXELS} are read: make it smaller")
    if min(width, height) < 2:
        raise PictureError(f"'{name}' has {width} x {height} pixels, too few for a landscape")
    if any(
        (np.asarray(a) != np.asarray(b)).any()
        for a, b in zip(header["dataWindow"], header["displayWindow"], strict=True)
    ):
        raise PictureError(f"'{name}': its data window is not its display window; write the whole picture")
    if header["type"] not in (library.scanlineimage, library.tiledimage):
        raise PictureError(f"'{name}' holds deep pixels, expected a flat picture")
    channels = header["channels"]
    # All channels are decoded.
    names = {channel.name for channel in channels}
    if len(channels) > MOST_CHANNELS or not ({"R", "G", "B"} <= names or "Y" in names):
        raise PictureError(
            f"'{name}' has the channels {', '.join(sorted(names)[:8])}, expected R, G, B or Y, and A alone"
        )
    if any((channel.xSampling, channel.ySampling) != (1, 1) for channel in channels):
        raise PictureError(f"'{name}' has channels of fewer pixels than the picture's, expected all of one size")
