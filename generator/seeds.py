"""Named, independent random streams.

Every random draw belongs to a stream that is named after its purpose. The stream's key and the frame's index go into
the spawn key of a NumPy ``SeedSequence``, whose hashing makes streams of neighbouring seeds, indices and names
statistically independent (O'Neill 2015, "Developing a seed_seq alternative"). Any frame can be reproduced alone.
"""

from __future__ import annotations

import zlib

import numpy as np


def stream_key(name: str) -> int:
    """Return the 32-bit key of a stream's name (CRC-32 of its UTF-8 bytes, the same on every machine)."""
    return zlib.crc32(name.encode())


def unit_stream(seed: int, unit: int | None, name: str) -> np.random.Generator:
    """Return the random generator for fixed properties of one particular sensor, the same in all its frames.

    `unit` is the sensor's number; if it is None, the sensor belongs to the scenario with root `seed`.
    """
    return random_stream(seed if unit is None else unit, f"unit.{name}", 0)


def random_stream(seed: int, name: str, index: int) -> np.random.Generator:
    """Return the generator of stream `name` for frame `index` of a scenario with root `seed`."""
    return np.random.Generator(np.random.PCG64DXSM(np.random.SeedSequence(seed, spawn_key=(stream_key(name), index))))
