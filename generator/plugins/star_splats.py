"""Distribution of starlight over pixels.

At each moment of a star's track, a stamp of its point spread function, integrated over each pixel, is added to the image
in 64-bit integers. Integer addition does not depend on order, so the image has the same bits on any number of threads. A
stamp is drawn row by row: one lane of the computation adds one row of one stamp, or a part of it, in packets of pixels
that are aligned in memory, which takes a quarter of the time of single pixels.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from generator.errors import GeneratorError
from generator.plugins.camera import FLOAT64, NightSkyCamera
from generator.plugins.filter_array import Pattern, choose
from generator.plugins.psf_atlas import PsfAtlas
from generator.plugins.stamp_light import StampLight
from generator.plugins.star_tracks import StarTracks

UINT64: Any = dr.uint64_array_t(mi.Float)
PACKET_BITS = 2
PACKET_PX = 1 << PACKET_BITS
PACKET: Any = dr.uint64_array_t(mi.Vector4u)
COPIES_BYTES = 1 << 28
"""Memory up to which each thread sums into an image of its own."""
Floats = NDArray[np.float64]
FINEST_BITS = 24
"""Binary digits of the splats' fixed-point sum below one electron: a resolution of 6e-8 electrons."""
SUM_BITS = 64
"""Binary digits of the sum."""
ROUNDING_MARGIN = 1.01
"""Factor on the light of all stars, larger than what rounding each splat to units adds."""
MOST_ELECTRONS = 1e30
"""Electrons that all stars give at most: far more than any sensor holds, and within single precision."""
LANES_AT_ONCE = 1_000_000
"""Rows of stamps in one launch: enough to fill any device, few enough for its memory."""
MOST_TAPS = 9
"""Most pixels that one lane adds: their code is unrolled, and more of it takes longer to compile."""


@dataclass(frozen=True)
class StampRows:
    """Rows of the stamps of some moments, split into parts, one lane each; all stamps have 2 x radius + 1 rows and columns.

    Attributes
    ----------
    moment : (m,) array
        Index of each moment in the tracks.
    radius : int
        Radius of the stamps, px.
    taps, parts : int
        Pixels in a part (the last in a row may have fewer), and parts in a row.
    owner : UInt32
        Index of the moment to which a lane belongs.
    du, dv : Float
        Offset from the star to the centre of the part's first pixel, px.
    left, row : Int32
        Column and row in the image of that pixel.
    inside : Int32
        Number of the part's taps that are in the stamp.
    """

    moment: NDArray[np.intp]
    radius: int
    taps: int
    parts: int
    owner: Any
    du: Any
    dv: Any
    left: Any
    row: Any
    inside: Any

    def per_lane(self, values: Floats) -> Any:
        """Expand values (m,) of the moments to a Float of the lanes."""
        return dr.gather(mi.Float, mi.Float(np.ascontiguousarray(values, dtype=np.float32)), self.owner)

    def index_per_lane(self, values: NDArray[np.integer[Any]]) -> Any:
        """Expand integers (m,) of the moments to a UInt32 of the lanes."""
        return dr.gather(mi.UInt32, mi.UInt32(values.astype(np.uint32)), self.owner)

    def seen(self, channels: list[Any], pattern: Pattern | None) -> tuple[list[Any], list[Any]]:
        """Values that even and odd taps record: all channels, or the channel of the pixel under a filter array."""
        if pattern is None:
            return channels, channels
        even, odd = (choose(pattern, channels, parity + self.left, self.row) for parity in (0, 1))
        return [even], [odd]

    def add(self, total: LightSum, taps: list[list[Any]], few: bool) -> None:
        """Add each part's electrons, one Float per tap and channel; `few` if all are less than `total.most_in_32_bits_e`."""
        least_inside = 2 * self.radius + 1 - (self.parts - 1) * self.taps
        offset, group = self.left & (PACKET_PX - 1), self.left >> PACKET_BITS
        for channel in range(len(taps[0])):
            units = []
            for tap, electrons in enumerate(taps):
                amount = electrons[channel]
                if tap >= least_inside:
                    amount = dr.select(self.inside > tap, amount, 0)
                # Conversion to 32 bits is one instruction; conversion to 64 bits takes many.
                if few:
                    units.append(mi.UInt32(mi.Int32(amount * total.units_per_e + 0.5)))
                else:
                    units.append(UINT64(FLOAT64(amount) * total.units_per_e + 0.5))
            nothing = type(units[0])(0)
            units += [nothing] * (-(len(units) + PACKET_PX - 1) % PACKET_PX + PACKET_PX - 1)
            # Offset from the part's first pixel to the packet's.
            for step in (1, 2):
                moved = (offset & step) != 0
                units = [
                    dr.select(moved, units[place - step] if place >= step else nothing, here)
                    for place, here in enumerate(units)
                ]
            for number in range(len(units) // PACKET_PX):
                total.add(channel, self.row, group + number, units[PACKET_PX * number : PACKET_PX * (number + 1)])


class LightSum:
    """The sum of all splats in an image, in fractions of an electron: 2^-FINEST_BITS, or larger ones for very much light.

    Parameters
    ----------
    width, height, planes : int
    all_e : float
        Electrons of all splats together.

    Raises
    ------
    GeneratorError
        They are MOST_ELECTRONS or more, or not a number.
    """

    def __init__(self, width: int, height: int, planes: int, all_e: float = 0.0) -> None:
        self.width, self.height, self.planes = width, height, planes
        self.units_per_e = units_per_electron(all_e)
        self.packets = math.ceil(width / PACKET_PX)
        self.total = dr.zeros(UINT64, planes * height * self.packets * PACKET_PX)
        apart = dr.thread_count() * 8 * dr.width(self.total) <= COPIES_BYTES
        on_processor = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        self.mode = dr.ReduceMode.Expand if apart and on_processor else dr.ReduceMode.Auto

    @property
    def most_in_32_bits_e(self) -> float:
        """Electrons below which a value fits into 32 bits."""
        return 2.0**31 / self.units_per_e

    def add(self, plane: int, row: Any, packet: Any, units: list[Any]) -> None:
        """Add units to the pixels of packets (Int32, by row), ignoring pixels outside the image."""
        inside = (row >= 0) & (row < self.height) & (packet >= 0) & (packet < self.packets)
        place = mi.UInt32((row + plane * self.height) * self.packets + packet)
        dr.scatter_add(self.total, PACKET(*(UINT64(unit) for unit in units)), place, inside, mode=self.mode)

    def image(self) -> Any:
        """Electrons, TensorXf (height, width, planes)."""
        stride = self.packets * PACKET_PX
        units = self.total
        if self.planes > 1 or stride != self.width:
            place = dr.arange(mi.UInt32, self.height * self.width * self.planes)
            pixel, plane = place // self.planes, place % self.planes
            row, column = pixel // self.width, pixel % self.width
            units = dr.gather(UINT64, units, (plane * self.height + row) * stride + column)
        return mi.TensorXf(mi.Float(FLOAT64(units) / self.units_per_e), (self.height, self.width, self.planes))


def stamp_rows(camera: NightSkyCamera, tracks: StarTracks, radius_px: NDArray[np.int64]) -> Iterator[StampRows]:
    """Rows of the stamps of all moments, in blocks of one radius that fit into memory, from the top of the image down.

    In this order, memory accesses are local.

    Parameters
    ----------
    camera, tracks
    radius_px : (n,) array
        Radius of each star's stamp.
    """
    radius_of_moment = radius_px[tracks.star]
    image_row = np.clip(tracks.v, 0, 2**16 - 1).astype(np.uint16)
    for radius in np.flatnonzero(np.bincount(radius_of_moment)).tolist():
        chosen = np.flatnonzero(radius_of_moment == radius)
        chosen = chosen[np.argsort(image_row[chosen], kind="stable")]
        side = 2 * radius + 1
        parts = math.ceil(side / MOST_TAPS)
        taps = math.ceil(side / parts)
        block = max(1, LANES_AT_ONCE // (side * parts))
        for start in range(0, len(chosen), block):
            moment = chosen[start : start + block]
            u, v = tracks.u[moment], tracks.v[moment]
            column, row = np.rint(u), np.rint(v)
            lane = dr.arange(mi.UInt32, len(moment) * side * parts)
            owner, place = lane // (side * parts), lane % (side * parts)
            down, across = mi.Int32(place // parts) - radius, mi.Int32(place % parts) * taps
            here = dr.gather(mi.Int32, mi.Int32(row.astype(np.int32)), owner) + down
            left = dr.gather(mi.Int32, mi.Int32(column.astype(np.int32)), owner) - radius + across
            yield StampRows(
                moment=moment,
                radius=radius,
                taps=taps,
                parts=parts,
                owner=owner,
                du=dr.gather(mi.Float, mi.Float((column - u).astype(np.float32)), owner) + mi.Float(across - radius),
                dv=dr.gather(mi.Float, mi.Float((row - v).astype(np.float32)), owner) + mi.Float(down),
                left=left,
                row=here,
                inside=side - across,
            )


def brightest_channel(electrons: Floats) -> Floats:
    """Electrons (n,) of stars in their brightest channel, from those by wavelength band (n, channels, bands)."""
    # NumPy takes three times as long to reduce a short last axis.
    by_channel = functools.reduce(np.add, np.moveaxis(electrons, 2, 0))
    return functools.reduce(np.maximum, by_channel.T)


def all_electrons(tracks: StarTracks, electrons: Floats) -> float:
    """Electrons of all stars' tracks together, each in its brightest channel, from those by band (n, channels, bands)."""
    return float((tracks.weight * brightest_channel(electrons)[tracks.star]).sum())


def units_per_electron(all_e: float) -> float:
    """Units of a sum per electron, a power of two: `all_e` electrons in one pixel are within the sum's range.

    Raises
    ------
    GeneratorError
        They are MOST_ELECTRONS or more, or not a number.
    """
    if not 0 <= all_e < MOST_ELECTRONS:
        raise GeneratorError(
            f"the stars and other points of light give {all_e:g} electrons, expected less than {MOST_ELECTRONS:g}; "
            "make the lights fainter, or camera.aperture_mm or time.exposure_s smaller"
        )
    return 2.0 ** min(FINEST_BITS, SUM_BITS - math.ceil(math.log2(ROUNDING_MARGIN * all_e + 1)))


def splat_gaussian(
    total: LightSum,
    camera: NightSkyCamera,
    tracks: StarTracks,
    electrons: Floats,
    sigma_px: float,
    light: StampLight,
    pattern: Pattern | None = None,
) -> None:
    """Add a Gaussian point spread function, integrated over pixels by the error function, at each moment.

    Parameters
    ----------
    total : LightSum
        Sum with as many planes as channels, or with one plane if there is a pattern.
    electrons : (n, channels) array
        Electrons of each star on the axis.
    light : StampLight
        Sizes of the stamps; light beyond a stamp is spread over it.
    pattern : Pattern, optional
        Filter array: only the channel that a pixel records is added.
    """
    channels = electrons.shape[1]
    scale = dr.opaque(mi.Float, 1 / (math.sqrt(2) * sigma_px))
    for rows in stamp_rows(camera, tracks, light.radii(electrons.max(axis=1))):
        weight = tracks.weight[rows.moment] * light.gain[rows.radius, 0, 0, 0]
        lights = weight[:, None] * electrons[tracks.star[rows.moment]]
        few = float(lights.max()) < total.most_in_32_bits_e
        in_row = 0.25 * (dr.erf((rows.dv + 0.5) * scale) - dr.erf((rows.dv - 0.5) * scale))
        amounts = rows.seen([rows.per_lane(lights[:, channel]) * in_row for channel in range(channels)], pattern)
        edges = [dr.erf((rows.du + (tap - 0.5)) * scale) for tap in range(rows.taps + 1)]
        shares = [after - before for before, after in itertools.pairwise(edges)]
        taps = [[amount * share for amount in amounts[tap % 2]] for tap, share in enumerate(shares)]
        rows.add(total, taps, few)
        dr.eval(total.total)


def splat_atlas(
    total: LightSum,
    camera: NightSkyCamera,
    tracks: StarTracks,
    electrons: Floats,
    atlas: PsfAtlas,
    light: StampLight,
    pattern: Pattern | None = None,
) -> None:
    """Add a tabulated point spread function at each moment.

    Parameters
    ----------
    total : LightSum
        Sum with as many planes as channels, or with one plane if there is a pattern.
    electrons : (n, channels, bands) array
        Electrons of each star on the axis, per wavelength band of the atlas.
    atlas : PsfAtlas
    light : StampLight
        Sizes of the stamps; light beyond a stamp is spread over it.
    pattern : Pattern, optional
        Filter array: only the channel that a pixel records is added.
    """
    channels = electrons.shape[1]
    brightest = brightest_channel(electrons)
    single = electrons.astype(np.float32)
    on_axis = mi.Float(single.ravel())
    # A sensor may have no response in a band.
    seen_bands = [band for band in range(atlas.bands) if single[:, :, band].any()]
    radius_px = np.minimum(light.radii(brightest) + atlas.shift_px, atlas.reach_px)
    for rows in stamp_rows(camera, tracks, radius_px):
        moment = rows.moment
        gain = light.gain[max(rows.radius - atlas.shift_px, 0)].reshape(atlas.bands, -1)
        weight = rows.per_lane(tracks.weight[moment])
        source = rows.index_per_lane(tracks.star[moment]) * (channels * atlas.bands)
        outward = (rows.per_lane((tracks.u[moment] - atlas.cx_px) / atlas.corner_px),
                   rows.per_lane((tracks.v[moment] - atlas.cy_px) / atlas.corner_px))  # fmt: skip
        most_e = float((tracks.weight[moment] * brightest[tracks.star[moment]]).max() * gain.max())
        few = most_e < total.most_in_32_bits_e
        stamp = rows.index_per_lane(atlas.node(tracks.u[moment], tracks.v[moment]))
        bands = []
        for band in seen_bands:
            du, dv = (
                start - mi.Float(float(atlas.shifts[band]) * away)
                for start, away in zip((rows.du, rows.dv), outward, strict=True)
            )
            shares = atlas.shares(band, stamp, du, dv, rows.taps)
            share = weight * dr.gather(mi.Float, mi.Float(gain[band].astype(np.float32)), stamp)
            lights = [
                share * dr.gather(mi.Float, on_axis, source + (channel * atlas.bands + band))
                for channel in range(channels)
            ]
            bands.append((shares, rows.seen(lights, pattern)))
        taps = []
        for tap in range(rows.taps):
            received = [mi.Float(0)] * (channels if pattern is None else 1)
            for shares, lights in bands:
                received = [
                    dr.fma(light, shares[tap], so_far) for light, so_far in zip(lights[tap % 2], received, strict=True)
                ]
            taps.append(received)
        rows.add(total, taps, few)
        dr.eval(total.total)
