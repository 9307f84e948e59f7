"""The command line of ``celnav``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from celnav.command.calibrate_arguments import add_calibrate
from celnav.solver import solvers

_EXAMPLES = """\
examples:
  celnav solve photo.jpg --time-zone Europe/Berlin --attitude altitude=62,roll=-3,tilt_sigma=0.5
  celnav solve photo.heic --attitude exif
  celnav solve sky.png --camera calibration.yml --utc 2020-01-01T00:00:00Z --attitude azimuth=120,altitude=45,roll=0
  celnav solve sky.jpg --camera unknown --utc 2020-01-01T00:00:00Z
  celnav solve frame-00000.png --camera frame-00000.json --attitude frame-00000.json \\
      --utc 2020-01-01T00:00:00Z --plot found.png

exit status: 0 a fix, 1 a refusal (the reason is printed), 2 input that cannot be used
"""
_DESCRIPTION = """\
Latitude and longitude from one image of the night sky.

Without --camera and --utc a photograph's EXIF tags say focal length and time; what was assumed is printed. Where nothing is
known of the lens, it is found from the stars. Without --attitude the stars are identified, but a position needs the
direction of the vertical.
"""


def parser() -> argparse.ArgumentParser:
    """Make the parser of the command."""
    program = argparse.ArgumentParser(
        prog="celnav",
        description="Where was this picture of the night sky taken?",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    program.add_argument("--version", action=_Version, help="print the version and end")
    commands = program.add_subparsers(dest="command", required=True, metavar="COMMAND")
    command = commands.add_parser(
        "solve",
        help="latitude and longitude from one image",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "image", metavar="IMAGE", help="PNG, JPEG, TIFF or HEIF of 8 or 16 bits, or FITS; pixels are used as stored"
    )
    _time_options(command.add_argument_group("time"))
    _camera_options(command.add_argument_group("camera"))
    group = command.add_argument_group("attitude and air")
    group.add_argument(
        "--attitude",
        default="unknown",
        metavar="ANGLES|NAME|FILE",
        help="degrees, azimuth=120,altitude=45,roll=0 of the boresight (no azimuth: heading unknown; tilt_sigma= and, with "
        "an azimuth, heading_sigma=: how uncertain); zenith-north-up; zenith: heading unknown; exif: the vertical "
        "of a telephone's accelerometer, tagged by Apple; unknown (the default): no position; or "
        "JSON with R_cam (ENU to camera), or a frame record",
    )
    group.add_argument(
        "--height-m",
        type=float,
        default=0.0,
        help="above the sea: the pressure and temperature follow it; default: %(default)s",
    )
    group.add_argument("--pressure-hpa", type=float, help="for refraction; by default that of the height")
    group.add_argument("--temperature-c", type=float, help="for refraction; by default that of the height")
    group = command.add_argument_group("solving")
    group.add_argument("--solver", default="skybench", choices=solvers(), help="default: %(default)s")
    group.add_argument("--mask", metavar="FILE", help="image that is not black where pixels are NOT to be used")
    group.add_argument(
        "--calibrate",
        choices=("none", "auto", "full"),
        help="what solver skybench fits of the camera: nothing; its focal length where that is clearly off; also principal "
        "point and distortion. Default: auto with --camera, else full",
    )
    group.add_argument(
        "--near",
        metavar="LAT,LON,KM",
        help="last known position and the radius that holds the answer: fewer stars then suffice, and a place beyond it is "
        "refused; solver skybench",
    )
    group.add_argument(
        "--time-limit-s",
        type=float,
        metavar="SECONDS",
        help="give the search for an identification up after so long; default: no limit but that of its work",
    )
    group.add_argument(
        "--sigma",
        metavar="NAME=VALUE,...",
        help="standard deviations: time= (s), focal= (relative), centre= (principal point, px), pressure= (hPa), "
        "temperature= (K), distortion= (k1). They enter the uncertainty; solver skybench finds focal length, principal "
        "point and distortion within them",
    )
    group = command.add_argument_group("output")
    group.add_argument("--json", action="store_true", help="print JSON")
    group.add_argument("--matches", action="store_true", help="also print every identified star")
    group.add_argument("--plot", metavar="FILE", help="draw the image and what was found in it; PNG")
    add_calibrate(commands)
    return program


def _time_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--utc", help="middle of the exposure, such as 2020-01-01T00:00:00Z; default: from the image's EXIF tags"
    )
    group.add_argument(
        "--time-zone",
        metavar="ZONE",
        help="of the camera's clock, +02:00 or Europe/Berlin, whatever the tags say; default: the tag of its offset, else "
        "its difference from the tag of GPS time; not for FITS, whose times are UTC",
    )
    group.add_argument(
        "--exif-time-is",
        choices=("start", "middle", "end"),
        default="start",
        help="what of the exposure the EXIF time marks; not for FITS, whose keywords say it; default: %(default)s",
    )
    group.add_argument("--dut1-s", type=float, help="UT1-UTC in seconds; default: from the IERS table")


def _camera_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--camera",
        metavar="FILE",
        help="JSON: a camera (with f_px or hfov_deg) or a frame record; YAML or JSON: a calibration of OpenCV or ROS; "
        "unknown: field (5 to 180 deg) and lens are found from the stars; default: a pinhole from the image's EXIF tags, "
        "unknown where they say nothing",
    )
    group.add_argument("--focal-length-mm", type=float, metavar="MM", help="without --camera: instead of the tags'")
    group.add_argument(
        "--sensor-width-mm", type=float, metavar="MM", help="without --camera: length of the image's rows on the sensor"
    )


class _Version(argparse.Action):
    """``--version``, which looks up the version only when the option is given."""

    def __init__(self, option_strings: Sequence[str], dest: str, **words: Any) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, **words)

    def __call__(self, parser: argparse.ArgumentParser, *given: object) -> None:
        from importlib.metadata import version

        print(f"celnav {version('skybench')}")
        parser.exit()
