"""Skylines that are drawn once and cached between processes, because drawing takes seconds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.ground.lamp import Lamp
from generator.ground.panorama import Panorama
from generator.ground.skylines.draw import skyline_panorama
from generator.identity.kept import Arrays, kept
from generator.seeds import random_stream

NUMBERS = ("azimuth_deg", "altitude_deg", "distance_m", "intensity_cd", "downward_cd")
"""Numeric attributes of a lamp."""


def stored_skyline(names: tuple[str, ...], seed: int, variant: int, glow_cd_m2: float) -> Panorama:
    """Panorama of skylines (:func:`generator.ground.skylines.draw.skyline_panorama`) from stream ``landscape`` of a seed."""

    def drawn() -> dict[str, NDArray[np.generic]]:
        return arrays_of(skyline_panorama(names, random_stream(seed, "landscape", variant), glow_cd_m2))

    return panorama_of(kept("skyline", (names, seed, variant), drawn), glow_cd_m2)


def arrays_of(panorama: Panorama) -> dict[str, NDArray[np.generic]]:
    """Convert a panorama, except its glow's luminance, to arrays."""
    planes = {
        "colour": panorama.colour,
        "alpha": panorama.alpha,
        "glow": panorama.glow,
        "distance": panorama.distance_m,
    }
    numbers = [[getattr(lamp, name) for name in NUMBERS] for lamp in panorama.lamps]
    return {name: plane for name, plane in planes.items() if plane is not None} | {
        "edges": np.array([panorama.top_deg, panorama.bottom_deg, panorama.white_reflectance], dtype=np.float64),
        "lamps": np.array(numbers, dtype=np.float64).reshape(-1, len(NUMBERS)),
        "kinds": np.array([lamp.kind for lamp in panorama.lamps], dtype=np.str_),
    }


def panorama_of(arrays: Arrays, glow_cd_m2: float) -> Panorama:
    """Restore the panorama from :func:`arrays_of`."""
    top_deg, bottom_deg, white = arrays["edges"].tolist()
    lamps = zip(arrays["lamps"].tolist(), arrays["kinds"].tolist(), strict=True)
    distance = arrays.get("distance")
    return Panorama(
        colour=arrays["colour"].astype(np.uint8, copy=False),
        alpha=arrays["alpha"].astype(np.uint8, copy=False),
        top_deg=top_deg,
        bottom_deg=bottom_deg,
        glow=arrays["glow"].astype(np.uint8, copy=False) if "glow" in arrays else None,
        glow_cd_m2=glow_cd_m2,
        distance_m=None if distance is None else distance.astype(np.float32, copy=False),
        lamps=tuple(Lamp(**dict(zip(NUMBERS, numbers, strict=True)), kind=kind) for numbers, kind in lamps),
        white_reflectance=white,
    )
