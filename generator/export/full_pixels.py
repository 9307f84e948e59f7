"""Detection of places where the sky itself saturates the sensor, so that a source leaves no trace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.dataset.reader import Frame

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RINGS_PX = (4, 16)
"""Widths of the rings examined around a source's light; the first is used whose pixels the source cannot have saturated by
itself."""
FULL_SHARE = 0.5
"""Fraction of saturated pixels around a source above which the sky counts as saturated. If the sky just reaches saturation,
noise saturates half of the pixels."""
NEARLY_FULL = 0.99
"""Fraction of the full well that counts as full, because offsets and read noise are added later."""
OWN_SHARE = 0.5
"""Fraction of the electrons that saturate all pixels around a source; a source with more may have saturated them by
itself."""


class FullPixels:
    """The saturated pixels of a frame.

    Parameters
    ----------
    frame : Frame
    """

    def __init__(self, frame: Frame) -> None:
        sensor = frame.record["sensor"]
        full = frame.image >= full_dn(sensor)
        self._sums = np.pad(full.astype(np.int64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
        self._full_e = min(
            float(sensor["full_well_e"]),
            (2.0 ** sensor["bits"] - 1 - sensor["black_level_dn"]) * float(sensor["gain_e_per_dn"]),
        )

    def touched(self, box: Floats) -> Bools:
        """Whether any pixel of each box is saturated; boxes (n, 4) are as in `Annotations`."""
        return self._counted(_outwards(box))[0] > 0

    def behind(self, box: Floats, electrons_e: Floats) -> Bools:
        """Whether the sky around each source's light saturates the sensor.

        Parameters
        ----------
        box : (n, 4) array
            Boxes as in `Annotations`.
        electrons_e : (n,) array
            Electrons of each source. For a source that may have saturated the pixels of all rings by itself, the whole
            image is examined.

        Returns
        -------
        (n,) bool array
        """
        inner = _outwards(box)
        full_in, pixels_in = self._counted(inner)
        image = self._sums[-1, -1], (self._sums.shape[0] - 1) * (self._sums.shape[1] - 1)
        found = np.full(len(box), image[0] > FULL_SHARE * image[1])
        # From the widest to the narrowest, which takes precedence if it is applicable.
        for width_px in reversed(RINGS_PX):
            full, pixels = self._counted(inner + width_px * np.array([-1, -1, 1, 1]))
            full, pixels = full - full_in, pixels - pixels_in
            alone = (electrons_e >= OWN_SHARE * pixels * self._full_e) | (pixels == 0)
            found = np.where(alone, found, full > FULL_SHARE * pixels)
        return found

    def _counted(self, box: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Numbers of saturated pixels and of image pixels in each box of whole pixels."""
        height, width = self._sums.shape[0] - 1, self._sums.shape[1] - 1
        left, right = (np.clip(box[:, axis], 0, width) for axis in (0, 2))
        top, bottom = (np.clip(box[:, axis], 0, height) for axis in (1, 3))
        sums = self._sums
        full = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
        return full, (right - left) * (bottom - top)


def full_dn(sensor: Mapping[str, Any]) -> float:
    """Value from which a pixel counts as saturated: the largest of the image, or that of a nearly full well.

    Parameters
    ----------
    sensor : mapping
        Sensor section of a frame record.
    """
    largest, gain = 2.0 ** sensor["bits"] - 1, float(sensor["gain_e_per_dn"])
    well_e = NEARLY_FULL * float(sensor["full_well_e"]) - 3.0 * float(sensor["read_noise_e"])
    well = sensor["black_level_dn"] + max(well_e, 0.0) / gain
    gamma = float(sensor.get("video", {}).get("gamma", 1.0))
    return float(min(largest, largest * (well / largest) ** (1.0 / gamma)))


def _outwards(box: Floats) -> NDArray[np.int64]:
    """Boxes of whole pixels that contain the boxes."""
    return np.concatenate([np.floor(box[:, :2]), np.ceil(box[:, 2:])], axis=1).astype(np.int64)
