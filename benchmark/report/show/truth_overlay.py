"""Truth drawn over the picture of a frame: time, place, attitude, and circles around the brightest stars with their names."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmark.report.show.star_names import star_name
from generator.scenario.model import pointing_of

MOST_NAMES = 12
"""Number of stars that get a circle and a name, the brightest of a frame."""
TEXT_COLOUR = (140, 220, 160)
STAR_COLOUR = (255, 176, 0)
PANEL_OPACITY = 150
"""Opacity, of 255, behind the lines of text."""
LEAST_TEXT_PX = 11
LINES_PER_HEIGHT = 32
Box = tuple[float, float, float, float]
"""Left, top, right and bottom, px."""


def truth_lines(record: dict[str, Any]) -> tuple[str, ...]:
    """Format time, place and attitude at mid-exposure, and the speed in a sequence."""
    site, pointing = record["site"], pointing_of(np.array(record["attitude"]["R_cam"], dtype=np.float64))
    latitude, longitude = site["latitude_deg"], (site["longitude_deg"] + 180) % 360 - 180
    lines = [
        f"{record['time']['utc_mid'][:23]}Z",
        f"{abs(latitude):.5f}° {'N' if latitude >= 0 else 'S'}  {abs(longitude):.5f}° {'E' if longitude >= 0 else 'W'}  "
        f"{site['height_m']:.0f} m",
        f"azimuth {pointing.azimuth_deg:.2f}°  altitude {pointing.altitude_deg:.2f}°  roll {pointing.roll_deg:.2f}°",
    ]
    if "sequence" in record:
        east, north, up = record["sequence"]["velocity_enu_m_s"]
        course = np.degrees(np.arctan2(east, north)) % 360
        speed = float(np.hypot(east, north))
        over_ground = f"  course {course:.1f}°  climb {up:.1f} m/s" if speed >= 0.05 else ""
        lines.append(f"{speed:.1f} m/s{over_ground}")
    return tuple(lines)


def draw_truth(
    picture: NDArray[np.uint8], record: dict[str, Any], stars: pd.DataFrame, reduction: int = 1
) -> NDArray[np.uint8]:
    """Draw a frame's truth over its picture.

    Parameters
    ----------
    picture : (height, width, 3) array
        Red, green, blue.
    record : dict
        The frame record.
    stars : DataFrame
        The frame's rows of the table of stars.
    reduction : int
        Pixels of the frame per pixel of the picture.

    Returns
    -------
    (height, width, 3) uint8 array
    """
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    size = max(LEAST_TEXT_PX, image.height // LINES_PER_HEIGHT)
    lines = truth_lines(record)
    panel = (
        0.0,
        0.0,
        max(draw.textlength(line, _font(size)) for line in lines) + size,
        (1.3 * len(lines) + 0.8) * size,
    )
    taken = [panel]
    for u, v, name in _named_stars(stars, reduction):
        taken.append(_draw_star(draw, u, v, name, size, taken))
    image.paste((0, 0, 0), (0, 0), Image.new("L", _extent(panel), PANEL_OPACITY))
    for number, line in enumerate(lines):
        draw.text((size / 2, size / 2 + 1.3 * size * number), line, TEXT_COLOUR, _font(size))
    return np.array(image, dtype=np.uint8)


def _named_stars(stars: pd.DataFrame, reduction: int) -> Iterator[tuple[float, float, str]]:
    """Position in the picture and name of the brightest stars of a frame."""
    shown = stars[(stars["fraction_in_frame"] > 0.5) & ~stars["occluded"]].nsmallest(MOST_NAMES, "v_mag")
    columns = ("centroid_u_px", "centroid_v_px", "star_id", "hip", "hr")
    for u, v, star_id, hip, hr in zip(*(shown[name].tolist() for name in columns), strict=True):
        # Pixel centres are at integers, also after averaging over blocks.
        yield (u - (reduction - 1) / 2) / reduction, (v - (reduction - 1) / 2) / reduction, star_name(star_id, hip, hr)


def _draw_star(draw: ImageDraw.ImageDraw, u: float, v: float, name: str, size: int, taken: list[Box]) -> Box:
    """Draw a circle, and the name next to it unless it would cover another; returns the bounding box of the drawing."""
    radius = 0.6 * size
    circle = (u - radius, v - radius, u + radius, v + radius)
    draw.ellipse(circle, outline=STAR_COLOUR, width=max(1, size // 12))
    right, width = u + 1.4 * radius, draw.textlength(name, _font(size))
    for left, anchor in ((right, "lm"), (u - 1.4 * radius - width, "rm")):
        box = (left, v - radius, left + width, v + radius)
        inside = left >= 0 and left + width <= draw.im.size[0]
        if inside and not any(_overlap(box, other) for other in taken):
            place = (left if anchor == "lm" else left + width, v)
            draw.text(
                place,
                name,
                STAR_COLOUR,
                _font(size),
                anchor=anchor,
                stroke_width=max(1, size // 8),
                stroke_fill="black",
            )
            return min(circle[0], box[0]), circle[1], max(circle[2], box[2]), circle[3]
    return circle


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _extent(box: Box) -> tuple[int, int]:
    left, top, right, bottom = (round(edge) for edge in box)
    return right - left, bottom - top


@functools.cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Load DejaVu Sans, which has the Greek letters of stars; it comes with Matplotlib."""
    import matplotlib as mpl

    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)
