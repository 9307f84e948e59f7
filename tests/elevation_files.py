"""GeoTIFF files of elevations, written by Pillow, for tests."""

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

DOUBLE, SHORT, ASCII = 12, 3, 2
WGS84_KEYS = (1024, 0, 1, 2), (1025, 0, 1, 1), (2048, 0, 1, 4326), (2054, 0, 1, 9102)


def utm_keys(code):
    return (1024, 0, 1, 1), (1025, 0, 1, 1), (3072, 0, 1, code), (3076, 0, 1, 9001)


def write_elevation(
    path, height_m, corner, pixel, keys=WGS84_KEYS, nodata=None, tags=None, kind=np.float32, compression=None
) -> None:
    """Write heights whose first pixel's upper left corner is at `corner` (x, y), with square or (x, y) pixels."""
    across, down = pixel if isinstance(pixel, tuple) else (pixel, pixel)
    directory = ImageFileDirectory_v2()
    values = {
        33550: (DOUBLE, (across, down, 0.0)),
        33922: (DOUBLE, (0.0, 0.0, 0.0, *corner, 0.0)),
        34735: (SHORT, (1, 1, 0, len(keys), *(number for key in keys for number in key))),
    }
    if nodata is not None:
        values[42113] = (ASCII, nodata)
    values |= tags or {}
    for tag, entry in values.items():
        if entry is not None:
            directory.tagtype[tag] = entry[0]
            directory[tag] = entry[1]
    image = Image.fromarray(np.asarray(height_m).astype(kind))
    image.save(path, format="TIFF", tiffinfo=directory, compression=compression)
