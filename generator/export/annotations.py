"""Content of a frame, as used to train detectors: categories, boxes of light, outlines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from generator.dataset.reader import Frame
from generator.export.full_pixels import FullPixels

Floats = NDArray[np.float64]

CATEGORIES = ("star", "planet", "moon", "satellite", "aircraft", "meteor", "cosmic_ray")
"""Categories; COCO numbers them from 1, YOLO from 0, in this order."""
HALF_WIDTH_SIGMAS = 3.0
"""Standard deviations of the point spread function from the places of light to the edges of a box."""
HALF_PIXEL = 0.5
"""Margin around the charge of a particle, which no lens has spread."""
LEAST_SHARE = 0.5
"""Fraction of a star's light on the sensor from which the star is annotated."""


@dataclass(frozen=True)
class Annotations:
    """The n sources of a frame that reach an SNR and are on a sky that does not saturate the sensor, stars and planets first.

    Attributes
    ----------
    category : (n,) int array
        Index in CATEGORIES.
    centre : (n, 2) array
        Centroid of the light, px from the image's corner, u and v: its first moment, including the point spread
        function's asymmetry and the lens's lateral colour. Datasets from before it was recorded have the geometric one.
    box : (n, 4) array
        Left, top, right and bottom edge of the light, px from the image's corner, cut at the image's edges.
    start, end : (n, 2) arrays
        Ends of streaks, px from the image's corner; both are the same for other sources.
    half_width : (n,) array
        Distance from a streak's centre line to its edge, px.
    snr, v_mag : (n,) arrays
        Signal-to-noise ratio and V; `v_mag` is NaN for cosmic rays.
    star_id : (n,) int array
        Id of a star or planet, otherwise 0.
    electrons_e : (n,) array
        Electrons of the whole source.
    saturated : (n,) bool array
        Whether some of its pixels are saturated.
    """

    category: NDArray[np.int64]
    centre: Floats
    box: Floats
    start: Floats
    end: Floats
    half_width: Floats
    snr: Floats
    v_mag: Floats
    star_id: NDArray[np.int64]
    electrons_e: Floats
    saturated: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.category)


def annotate(frame: Frame, least_snr: float) -> Annotations:
    """Annotate a frame."""
    camera = frame.record["camera"]
    margin = HALF_WIDTH_SIGMAS * float(frame.record["optics"]["psf_sigma_px"])
    stars, objects = _stars(frame.stars, least_snr), _objects(frame.objects, least_snr)
    columns: dict[str, Any] = {name: np.concatenate([stars[name], objects[name]]) for name in stars}
    particle = columns["category"] == CATEGORIES.index("cosmic_ray")
    half_width = np.where(particle, HALF_PIXEL, margin)
    # Offset from pixel centres at integers to the image's corner.
    low, high = (columns.pop(name) + 0.5 for name in ("low", "high"))
    size = np.array([camera["width"], camera["height"]], dtype=np.float64)
    box = np.concatenate(
        [np.clip(low - half_width[:, None], 0, size), np.clip(high + half_width[:, None], 0, size)], axis=1
    )
    places = {name: columns.pop(name) + 0.5 for name in ("centre", "start", "end")}
    found = Annotations(box=box, half_width=half_width, **places, **columns)
    pixels = FullPixels(frame)
    inside = (box[:, 2] > box[:, 0]) & (box[:, 3] > box[:, 1])
    seen = np.flatnonzero(inside & ~pixels.behind(box, found.electrons_e))
    # For stars and planets the truth states this.
    full = found.saturated | ((found.star_id == 0) & pixels.touched(box))
    return Annotations(**{name: values[seen] for name, values in (vars(found) | {"saturated": full}).items()})


def outlines(found: Annotations, width: int, height: int) -> list[Floats]:
    """Outline of each source, a (k, 2) polygon, px from the image's corner.

    A straight streak longer than wide becomes a rectangle along it, anything else an octagon in its box.
    """
    way = found.end - found.start
    length = np.hypot(way[:, 0], way[:, 1])
    # The light of a camera that swings leaves the line between its first and last place.
    margin = 2 * found.half_width[:, None]
    astray = (found.box[:, :2] < np.minimum(found.start, found.end) - margin).any(axis=1)
    astray |= (found.box[:, 2:] > np.maximum(found.start, found.end) + margin).any(axis=1)
    streak = (length > 2 * found.half_width) & ~astray
    along = np.divide(way, length[:, None], out=np.zeros_like(way), where=length[:, None] > 0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) * found.half_width[:, None]
    before, after = (
        found.start - along * found.half_width[:, None],
        found.end + along * found.half_width[:, None],
    )
    rectangles = np.stack([before + across, after + across, after - across, before - across], axis=1)
    angle = (np.arange(8) + 0.5) * np.pi / 4
    # The octagon whose flat sides touch the box.
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1) / np.cos(np.pi / 8)
    middle, half = (found.box[:, :2] + found.box[:, 2:]) / 2, (found.box[:, 2:] - found.box[:, :2]) / 2
    octagons = middle[:, None] + half[:, None] * unit
    shapes = []
    for row in range(len(found)):
        shape = clipped(rectangles[row], width, height) if streak[row] else octagons[row]
        shapes.append(shape if len(shape) >= 3 else octagons[row])
    return shapes


def clipped(polygon: Floats, width: float, height: float) -> Floats:
    """The part of a convex polygon, (k, 2), within the image (Sutherland and Hodgman 1974, CACM 17, 32)."""
    for axis, limit, sign in ((0, 0.0, 1.0), (0, width, -1.0), (1, 0.0, 1.0), (1, height, -1.0)):
        depth = sign * (polygon[:, axis] - limit)
        if not len(polygon) or (depth >= 0).all():
            continue
        kept = []
        for here, there, depth_here, depth_there in zip(
            polygon, np.roll(polygon, -1, axis=0), depth, np.roll(depth, -1), strict=True
        ):
            if depth_here >= 0:
                kept.append(here)
            if (depth_here >= 0) != (depth_there >= 0):
                kept.append(here + (there - here) * depth_here / (depth_here - depth_there))
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def area_px(polygon: Floats) -> float:
    """Area of a polygon, (k, 2)."""
    u, v = polygon.T
    return float(abs(u @ np.roll(v, -1) - v @ np.roll(u, -1)) / 2)


def _stars(table: pa.Table, least_snr: float) -> dict[str, NDArray[Any]]:
    stars = table.to_pandas()
    stars = stars[(stars["snr"] >= least_snr) & (stars["fraction_in_frame"] >= LEAST_SHARE)]
    centre, start, end = (stars[[f"{name}_u_px", f"{name}_v_px"]].to_numpy() for name in ("centroid", "start", "end"))
    offset = _light_offset(stars)
    centre, start, end = (place + offset for place in (centre, start, end))
    low, high = _reach(stars, np.stack([centre, start, end]), offset)
    kinds = {kind: number for number, kind in enumerate(CATEGORIES)}
    return {
        "category": stars["kind"].map(kinds).to_numpy(np.int64),
        "centre": centre,
        "start": start,
        "end": end,
        "low": low,
        "high": high,
        "snr": stars["snr"].to_numpy(np.float64),
        "v_mag": stars["v_mag"].to_numpy(np.float64),
        "star_id": stars["star_id"].to_numpy(np.int64),
        "electrons_e": stars["electrons_e"].to_numpy(np.float64),
        "saturated": stars["saturated"].to_numpy(np.bool_),
    }


def _reach(table: pd.DataFrame, places: Floats, offset: Floats) -> tuple[Floats, Floats]:
    """Least and greatest u and v of the light, px, (n, 2) arrays.

    They are stated in the table, for the geometric places; tables of before have only `places`, (k, n, 2), of the light.
    """
    low, high = places.min(axis=0), places.max(axis=0)
    if "low_u_px" not in table:
        return low, high
    stated = (table[[f"{name}_u_px", f"{name}_v_px"]].to_numpy(np.float64) + offset for name in ("low", "high"))
    return np.fmin(low, next(stated)), np.fmax(high, next(stated))


def _light_offset(table: pd.DataFrame) -> Floats:
    """Offset from the geometric centroid to that of the light, px, (n, 2); 0 in tables without the latter."""
    if "light_u_px" not in table:
        return np.zeros((len(table), 2))
    return np.stack([table[f"light_{axis}_px"] - table[f"centroid_{axis}_px"] for axis in ("u", "v")], axis=1)


def _objects(table: pa.Table, least_snr: float) -> dict[str, NDArray[Any]]:
    objects = table.to_pandas()
    seen = (objects["snr"] >= least_snr) & (objects["fraction_in_frame"] > 0) & objects["low_u_px"].notna()
    objects = objects[seen & objects["kind"].isin(CATEGORIES)]
    places = {
        name: objects[[f"{column}_u_px", f"{column}_v_px"]].to_numpy()
        for name, column in
        (("centre", "centroid"), ("start", "start"), ("end", "end"), ("low", "low"), ("high", "high"))
    }  # fmt: skip
    offset = _light_offset(objects)
    places = {name: place + offset for name, place in places.items()}
    # The ends of an object's path may be far from the frame; its light is within its box.
    for name in ("start", "end"):
        places[name] = np.where(np.isfinite(places[name]), places[name], places["centre"])
    kinds = {kind: number for number, kind in enumerate(CATEGORIES)}
    return {
        "category": objects["kind"].map(kinds).to_numpy(np.int64),
        **places,
        "snr": objects["snr"].to_numpy(np.float64),
        "v_mag": objects["v_mag"].to_numpy(np.float64),
        "star_id": np.zeros(len(objects), np.int64),
        "electrons_e": objects["electrons_e"].to_numpy(np.float64),
        "saturated": np.zeros(len(objects), np.bool_),
    }
