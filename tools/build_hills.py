"""Make scenes/hills.tif: invented hills around a valley, a GeoTIFF of heights every 150 m in UTM zone 32.

It is a fractal surface whose power falls with the frequency to the power -3.4, so that its profiles fall with -2.4 like those
of natural relief (Turcotte 1997), with a lake in the middle. The file has the same bytes on every machine with the same
libtiff.
"""

from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

SIDE, PIXEL_M = 320, 150.0
CORNER_M = (640_000.0, 5_230_000.0)
SLOPE = -3.4
DOUBLE, SHORT, ASCII = 12, 3, 2
KEYS = ((1024, 0, 1, 1), (1025, 0, 1, 1), (3072, 0, 1, 32632), (3076, 0, 1, 9001), (4099, 0, 1, 9001))


def heights() -> np.ndarray:
    """Heights in metres, (SIDE, SIDE) int16 array."""
    rng = np.random.default_rng(20)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.rfftfreq(SIDE), indexing="ij"))
    amplitude = np.where(frequency > 0, np.maximum(frequency, 1e-9) ** (SLOPE / 2), 0)
    surface = np.fft.irfft2(amplitude * np.exp(2j * np.pi * rng.random(frequency.shape)), (SIDE, SIDE))
    surface /= surface.std()
    y, x = np.indices(surface.shape) - SIDE / 2
    # A basin 8 km wide with a lake at 600 m.
    valley = np.exp(-((np.hypot(x, y) * PIXEL_M / 5500) ** 4))
    relief = 1700 + 750 * surface
    return np.maximum(relief * (1 - valley) + (610 + 20 * surface) * valley, 600).astype(np.int16)


def main() -> None:
    """Write the file."""
    directory = ImageFileDirectory_v2()
    tags = {
        33550: (DOUBLE, (PIXEL_M, PIXEL_M, 0.0)),
        33922: (DOUBLE, (0.0, 0.0, 0.0, *CORNER_M, 0.0)),
        34735: (SHORT, (1, 1, 0, len(KEYS), *(number for key in KEYS for number in key))),
        42113: (ASCII, "-32768"),
    }
    for tag, (kind, value) in tags.items():
        directory.tagtype[tag] = kind
        directory[tag] = value
    path = Path(__file__).parents[1] / "scenes" / "hills.tif"
    Image.fromarray(heights()).save(path, tiffinfo=directory, compression="tiff_adobe_deflate")


if __name__ == "__main__":
    main()
