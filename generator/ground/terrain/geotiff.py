"""Elevation rasters in GeoTIFF files, in geographic or UTM coordinates.

Source of the tags and keys: OGC 19-008r4, "OGC GeoTIFF standard", version 1.1 (2019); the tag of missing values is
GDAL's. Pixels are decoded by Pillow, after the size in the header has been checked.
"""

from __future__ import annotations

import io
import struct
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import TiffImageFile

from generator.ground.panorama import MOST_TEXELS
from generator.ground.terrain.transverse_mercator import utm

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

PIXEL_SCALE, TIEPOINT, TRANSFORMATION = 33550, 33922, 34264
GEO_KEYS, NO_DATA = 34735, 42113
MODEL_TYPE, RASTER_TYPE, GEOGRAPHIC_TYPE, ANGULAR_UNITS = 1024, 1025, 2048, 2054
PROJECTED_TYPE, LINEAR_UNITS, VERTICAL_UNITS = 3072, 3076, 4099
PROJECTED, GEOGRAPHIC = 1, 2
DEGREE, METRE = 9102, 9001
USER_DEFINED = 32767
DATUMS = (4326, 4979, 4258, 4269, 4937, 4152)
"""WGS84, ETRS89, NAD83 and NAD83(HARN), which agree within two metres."""
UTM_NORTH, UTM_SOUTH = (32600, 25800, 26900), (32700,)
"""Codes of UTM zone 0 on WGS84, ETRS89 and NAD83."""
MODES = ("F", "I", "I;16", "I;16B", "I;16L")
LOWEST_M, HIGHEST_M = -1000.0, 9500.0
MOST_KEYS = 200


class ElevationError(ValueError):
    """The file is not a usable elevation raster; the message says what was found and what is expected."""


@dataclass(frozen=True)
class Grid:
    """Position of an elevation raster.

    Attributes
    ----------
    to_pixel : (2, 3) nested tuple
        Column and row, 0 at the centre of the first pixel, are this matrix times (x, y, 1).
    zone : int
        Zone of UTM; 0 if x and y are longitude and latitude, deg.
    south : bool
        Whether the zone's northings are those of the southern hemisphere.
    """

    to_pixel: tuple[tuple[float, float, float], tuple[float, float, float]]
    zone: int = 0
    south: bool = False

    def pixel(self, latitude_deg: Floats, longitude_deg: Floats) -> tuple[Floats, Floats]:
        """Columns and rows of geodetic positions (any shape); longitudes are not shifted to the raster's range."""
        x, y = np.asarray(longitude_deg, float), np.asarray(latitude_deg, float)
        if self.zone:
            x, y = utm(y, x, self.zone, self.south)
        (a, b, c), (d, e, f) = self.to_pixel
        return a * x + b * y + c, d * x + e * y + f


@dataclass(frozen=True, eq=False)
class Elevation:
    """An elevation raster.

    Attributes
    ----------
    height_m : (ny, nx) float32 array
        Heights; NaN where the file has none.
    grid : Grid
    """

    height_m: Singles
    grid: Grid

    def at(self, column: Floats, row: Floats) -> Floats:
        """Heights, m, bilinear between the pixels' centres; NaN outside the raster and next to missing values."""
        ny, nx = self.height_m.shape
        # The raster is continued by half a pixel beyond the outermost centres.
        inside = (column >= -0.5) & (column <= nx - 0.5) & (row >= -0.5) & (row <= ny - 0.5)
        column, row = np.clip(np.where(inside, column, 0), 0, nx - 1), np.clip(np.where(inside, row, 0), 0, ny - 1)
        left, top = np.minimum(column.astype(np.intp), nx - 2), np.minimum(row.astype(np.intp), ny - 2)
        across, down = column - left, row - top
        flat, place = self.height_m.ravel(), top * nx + left
        upper = flat[place] * (1 - across) + flat[place + 1] * across
        lower = flat[place + nx] * (1 - across) + flat[place + nx + 1] * across
        return np.where(inside, upper * (1 - down) + lower * down, np.nan)

    def at_place(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float] | None:
        """Height, m, at a geodetic position, and its longitude in the raster's range; None if there is no height."""
        turns = longitude_deg + np.array([0.0, -360.0, 360.0])
        heights = self.at(*self.grid.pixel(np.full(3, latitude_deg), turns))
        found = np.flatnonzero(np.isfinite(heights))
        return (float(heights[found[0]]), float(turns[found[0]])) if len(found) else None


def read_elevation(data: bytes, name: str) -> Elevation:
    """Decode an elevation raster.

    Raises
    ------
    ElevationError
        The file has another format, too many pixels, unsupported coordinates or units, or is damaged.
    """
    try:
        with warnings.catch_warnings():
            # Pillow warns of large pictures, which are refused below, and of unusual tags.
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=("TIFF",)) as image:
                width, height = image.size
                if width * height > MOST_TEXELS:
                    raise ElevationError(
                        f"'{name}' has {width} x {height} pixels; at most {MOST_TEXELS} are read: cut it, or make it coarser"
                    )
                if min(width, height) < 2:
                    raise ElevationError(f"'{name}' has {width} x {height} pixels, too few for hills")
                if image.mode not in MODES:
                    raise ElevationError(
                        f"'{name}' has pixels of the kind {image.mode}, as pictures have; expected heights: one band of "
                        "16- or 32-bit integers or of floats"
                    )
                assert isinstance(image, TiffImageFile)
                tags = dict(image.tag_v2)
                grid = _grid(tags, name)
                values = np.array(image, dtype=np.float32)
    except ElevationError:
        raise
    except (OSError, SyntaxError, ValueError, EOFError, KeyError, TypeError, IndexError, OverflowError, struct.error,
            Image.DecompressionBombError) as error:  # fmt: skip
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise ElevationError(f"'{name}' cannot be read as an elevation raster ({reason}); expected GeoTIFF") from error
    return Elevation(_heights(values, tags.get(NO_DATA), name), grid)


def _heights(values: Singles, missing: object, name: str) -> Singles:
    """Heights with missing values as NaN."""
    if missing is not None:
        text = str(missing).strip("\0 ")
        try:
            values[values == np.float32(text)] = np.nan
        except ValueError as error:
            raise ElevationError(f"'{name}': the value of missing heights is {text[:20]!r}, not a number") from error
    if np.isinf(values).any():
        raise ElevationError(f"'{name}': found infinite heights")
    if np.isnan(values).all():
        raise ElevationError(f"'{name}': all heights are missing")
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low < LOWEST_M or high > HIGHEST_M:
        raise ElevationError(
            f"'{name}': found heights from {low:g} to {high:g}, expected {LOWEST_M:g} to {HIGHEST_M:g} m; a value that "
            "stands for missing heights belongs into the tag GDAL_NODATA"
        )
    return values


def _grid(tags: dict[int, Any], name: str) -> Grid:
    """Coordinates of a raster from its tags."""
    keys = _geo_keys(tags, name)
    zone, south = _zone(keys, name)
    matrix = _to_model(tags, name)
    # Coordinates are those of the pixels' corners unless the raster states that its pixels are points.
    half = 0.0 if keys.get(RASTER_TYPE, 1) == 2 else 0.5
    matrix = matrix @ np.array([[1, 0, half], [0, 1, half], [0, 0, 1]])
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-18:
        raise ElevationError(f"'{name}': the pixels have no size; see the tags ModelPixelScale and ModelTransformation")
    corner = np.abs(matrix[:2, 2])
    if not zone and (corner > (541.0, 91.0)).any():
        raise ElevationError(f"'{name}': begins at longitude {matrix[0, 2]:g}, latitude {matrix[1, 2]:g} deg")
    (a, b, c), (d, e, f), _ = np.linalg.inv(matrix).tolist()
    return Grid(((a, b, c), (d, e, f)), zone, south)


def _geo_keys(tags: dict[int, Any], name: str) -> dict[int, int]:
    """GeoKeys whose values are in the directory itself."""
    directory = tags.get(GEO_KEYS)
    if directory is None:
        raise ElevationError(f"'{name}' has no GeoKeyDirectory: a TIFF without coordinates; expected GeoTIFF")
    numbers = [int(number) for number in directory]
    count = numbers[3] if len(numbers) > 3 else 0
    if not 0 < count <= MOST_KEYS or len(numbers) < 4 + 4 * count:
        raise ElevationError(f"'{name}': the GeoKeyDirectory is damaged")
    entries = [numbers[4 + 4 * k : 8 + 4 * k] for k in range(count)]
    return {key: value for key, place, _, value in entries if place == 0}


def _zone(keys: dict[int, int], name: str) -> tuple[int, bool]:
    """Zone of UTM (0: geographic) and whether it counts from the south."""
    if keys.get(VERTICAL_UNITS, METRE) != METRE:
        raise ElevationError(f"'{name}': VerticalUnits is {keys[VERTICAL_UNITS]}, expected {METRE} (metres)")
    model = keys.get(MODEL_TYPE)
    if model == GEOGRAPHIC:
        if keys.get(ANGULAR_UNITS, DEGREE) != DEGREE:
            raise ElevationError(f"'{name}': GeogAngularUnits is {keys[ANGULAR_UNITS]}, expected {DEGREE} (degrees)")
        datum = keys.get(GEOGRAPHIC_TYPE, USER_DEFINED)
        if datum not in DATUMS:
            raise ElevationError(f"'{name}': GeographicType is {datum}, expected 4326 (WGS84), 4258 or 4269")
        return 0, False
    if model == PROJECTED:
        if keys.get(LINEAR_UNITS, METRE) != METRE:
            raise ElevationError(f"'{name}': ProjLinearUnits is {keys[LINEAR_UNITS]}, expected {METRE} (metres)")
        code = keys.get(PROJECTED_TYPE, USER_DEFINED)
        for first, south in [(first, False) for first in UTM_NORTH] + [(first, True) for first in UTM_SOUTH]:
            if 1 <= code - first <= 60:
                return code - first, south
        raise ElevationError(
            f"'{name}': ProjectedCSType is {code}, expected UTM (326zz, 327zz, 258zz or 269zz for zone zz): convert it, for "
            "example by gdalwarp -t_srs EPSG:4326"
        )
    raise ElevationError(f"'{name}': GTModelType is {model}, expected 1 (projected) or 2 (geographic)")


def _to_model(tags: dict[int, Any], name: str) -> Floats:
    """Matrix (3, 3) from pixels, counted from the first one's corner, to coordinates."""
    if TRANSFORMATION in tags:
        whole = np.array([float(number) for number in tags[TRANSFORMATION]])
        if len(whole) != 16:
            raise ElevationError(f"'{name}': ModelTransformation has {len(whole)} numbers, expected 16")
        whole = whole.reshape(4, 4)
        return np.array([[*whole[0, :2], whole[0, 3]], [*whole[1, :2], whole[1, 3]], [0, 0, 1]])
    if PIXEL_SCALE not in tags or TIEPOINT not in tags:
        raise ElevationError(f"'{name}': neither ModelTransformation nor ModelPixelScale with ModelTiepoint")
    scale = [float(number) for number in tags[PIXEL_SCALE]]
    tie = [float(number) for number in tags[TIEPOINT]]
    if len(scale) < 2 or len(tie) != 6:
        raise ElevationError(f"'{name}': {len(tie) // 6} tie points; one, with ModelPixelScale, is read")
    return np.array([[scale[0], 0, tie[3] - tie[0] * scale[0]], [0, -scale[1], tie[4] + tie[1] * scale[1]], [0, 0, 1]])
