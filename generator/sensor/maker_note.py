"""A telephone's accelerometer in the maker note of its photographs, in Apple's layout.

ExifTool documents the layout (lib/Image/ExifTool/MakerNotes.pm and Apple.pm): a header of 14 bytes, ``Apple iOS``, a
version and a mark of the byte order; then a TIFF directory whose offsets count from the header's first byte; tag 0x0008,
AccelerationVector, three signed fractions in units of g. Photographs with public tags establish the axes: telephones held
level wrote about (-1, 0, 0) with orientation 1 and (0, -1, 0) with orientation 6, and a positive third number when they
looked up (`tests/unit/test_maker_note.py`). This is gravity along Core Motion's axes: x to the right of the screen, y to
its top, z out of it. The rows of the stored picture are along the telephone's long side.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from generator.scenario.processing.develop_spec import GravitySpec

Floats = NDArray[np.float64]

HEADER = b"Apple iOS\x00\x00\x01MM"
VERSION_TAG, ACCELERATION_TAG = 0x0001, 0x0008
LONG, SIGNED_FRACTION = 9, 10
"""TIFF's types of a signed integer and of a fraction of two signed integers."""
NOTE_VERSION = 1
STEP = 100_000_000
"""Denominator of the fractions."""
LARGEST_G = 20.0
"""Largest acceleration that the fractions can represent."""


def accelerometer(
    R_cam: Floats, spec: GravitySpec, unit: np.random.Generator, frame: np.random.Generator
) -> tuple[float, float, float]:
    """Reading of the accelerometer of a camera at rest, g, along the telephone's axes.

    Parameters
    ----------
    R_cam : (3, 3) array
        Rotation from ENU to the camera frame.
    spec : GravitySpec
    unit, frame : Generator
        Random generators of the telephone, the same for all frames, and of the frame.
    """
    up = R_cam @ np.array([0.0, 0.0, 1.0])
    axes = np.array([up[1], up[0], up[2]])
    offset = spec.offset_mg * unit.standard_normal(3) + spec.noise_mg * frame.standard_normal(3)
    x, y, z = (float(value) for value in axes + offset / 1000)
    return x, y, z


def apple_note(acceleration_g: tuple[float, float, float]) -> bytes:
    """A maker note with its version and an acceleration, big-endian.

    Raises
    ------
    ValueError
        An acceleration is beyond LARGEST_G.
    """
    if max(abs(value) for value in acceleration_g) > LARGEST_G:
        raise ValueError(f"an acceleration of {acceleration_g} g, beyond {LARGEST_G:g} g")
    entries = [
        struct.pack(">HHIi", VERSION_TAG, LONG, 1, NOTE_VERSION),
        struct.pack(">HHII", ACCELERATION_TAG, SIGNED_FRACTION, 3, len(HEADER) + 2 + 2 * 12 + 4),
    ]
    fractions = b"".join(struct.pack(">ii", round(value * STEP), STEP) for value in acceleration_g)
    return HEADER + struct.pack(">H", len(entries)) + b"".join(entries) + struct.pack(">I", 0) + fractions
