"""Arguments of ``celnav calibrate``."""

from __future__ import annotations

import argparse
from typing import Any

_EXAMPLES = """\
examples:
  celnav calibrate night/*.fits.bz2 --lat 34.4773 --lon -111.4332 --height-m 2361 --out camera.json --map residuals.png
  celnav calibrate photo1.jpg photo2.jpg --time-zone Europe/Berlin --lat 52.3 --lon 13.1 --out camera.json --opencv lens.yml
  celnav calibrate platepars_all_recalibrated.json --lat 51.883 --lon -1.306 --height-m 80 --out camera.json
  celnav solve frame.fits --camera camera.json --attitude camera.json

exit status: 0 a calibration, 2 input that cannot be used
"""
_DESCRIPTION = """\
Lens and mount of a camera from the stars of one or more frames at a known place and time.

Nothing about the lens has to be known: its field, its law, and its distortion, decentring and tilt are found, and chosen by
how well they predict stars that they were not fitted to. Frames of a fixed camera share one attitude for each night where
they can. The file holds the camera, the attitude with standard deviations, and their covariance.
"""


def add_calibrate(commands: Any) -> None:
    """Add the command to the parser's commands."""
    command = commands.add_parser(
        "calibrate",
        help="lens and mount of a camera from the stars",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "frames",
        metavar="FRAME",
        nargs="+",
        help="FITS (also .gz, .bz2), PNG, JPEG or TIFF of one camera; or platepars_all_recalibrated.json of RMS, whose "
        "centroids are used and whose names are not",
    )
    group = command.add_argument_group("place and air")
    group.add_argument("--lat", type=float, required=True, metavar="DEG", help="geodetic latitude")
    group.add_argument("--lon", type=float, required=True, metavar="DEG", help="longitude, east positive")
    group.add_argument("--height-m", type=float, default=0.0, help="above the sea; default: %(default)s")
    group.add_argument("--pressure-hpa", type=float, help="for refraction; by default that of the height")
    group.add_argument("--temperature-c", type=float, help="for refraction; by default that of the height")
    group = command.add_argument_group("time")
    group.add_argument(
        "--utc",
        action="append",
        help="middle of an exposure, once for each frame; default: the FITS header, the frame record beside the image, EXIF",
    )
    group.add_argument(
        "--time-zone",
        metavar="ZONE",
        help="of the camera's clock, +02:00 or Europe/Berlin, whatever the EXIF tags say; not for FITS, whose times are UTC",
    )
    group.add_argument(
        "--exif-time-is",
        choices=("start", "middle", "end"),
        default="start",
        help="what of the exposure the EXIF time marks; not for FITS, whose keywords say it; default: %(default)s",
    )
    group.add_argument("--dut1-s", type=float, help="UT1-UTC in seconds; default: from the IERS table")
    group = command.add_argument_group("camera")
    group.add_argument(
        "--camera",
        metavar="FILE",
        help="a guess whose focal length is within 6 %%: whatever celnav solve takes, or a platepar; default: "
        "everything is searched",
    )
    group.add_argument(
        "--models",
        type=lambda text: tuple(text.split(",")),
        metavar="NAME,NAME",
        help="laws to choose among: pinhole, brown_conrady, kannala_brandt, equidistant, equisolid, stereographic, "
        "orthographic",
    )
    group.add_argument("--opencv-only", action="store_true", help="only lenses that OpenCV can hold")
    group.add_argument(
        "--mount",
        choices=("auto", "night", "frame"),
        default="auto",
        help="one attitude for a night or for each frame; auto: a night's unless its frames differ; default: %(default)s",
    )
    group.add_argument(
        "--mask",
        metavar="FILE",
        help="image that is not black where pixels are NOT to be used; default: learnt from five or more images",
    )
    group = command.add_argument_group("output")
    group.add_argument(
        "--out", required=True, metavar="FILE", help="the calibration, JSON: camera, attitude, covariance"
    )
    group.add_argument(
        "--opencv", metavar="FILE", help="also OpenCV's matrix and coefficients: .yml or .json; implies --opencv-only"
    )
    group.add_argument("--scenario", metavar="FILE", help="also a scenario of the generator, YAML")
    group.add_argument(
        "--mask-out",
        metavar="FILE",
        help="also the mask as --mask of this command and of celnav solve takes it, PNG: white where pixels are not used",
    )
    group.add_argument("--map", metavar="FILE", help="draw the map of residuals: .png, .svg or .pdf")
    group.add_argument("--json", action="store_true", help="print the calibration instead of the report")
