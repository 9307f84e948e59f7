"""Names of stars, as printed for the rows of a table of stars."""

import functools

from celnav.sky.star_names import star_name as catalogue_name
from generator.places.ephemeris import PLANET_ID_BASE, PLANET_IDS


def star_name(star_id: int, hip: int, hr: int) -> str:
    """Name of a row of the table of stars: Sirius, ε CMa, 61 Cyg, HR 1, HIP 2, Jupiter, star 3."""
    if star_id > PLANET_ID_BASE:
        return _planet_names().get(star_id, f"object {star_id - PLANET_ID_BASE}")
    return catalogue_name(hip, hr) or f"star {star_id}"


@functools.cache
def _planet_names() -> dict[int, str]:
    return {PLANET_ID_BASE + number: name.capitalize() for name, number in PLANET_IDS.items()}
