"""Selection of the channel that a pixel under a colour filter array records."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

Pattern = tuple[tuple[int, int], tuple[int, int]]
"""Channels of the first 2 x 2 pixels, by row and column."""


def choose(pattern: Pattern, channels: list[Any], column: Any, row: Any) -> Any:
    """Values of the channel that pixels (Int32 columns and rows) record."""
    right, low = (column & 1) == 1, (row & 1) == 1
    upper, lower = (dr.select(right, channels[there], channels[here]) for here, there in pattern)
    return dr.select(low, lower, upper)


def chosen(pattern: Pattern, planes: list[Any], width: int, height: int) -> Any:
    """Values that the pixels of a frame record of the planes (Float) of its channels."""
    pixel = dr.arange(mi.UInt32, width * height)
    return choose(pattern, planes, mi.Int32(pixel % width), mi.Int32(pixel // width))
