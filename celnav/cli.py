"""The command ``celnav``."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence

import numpy as np

from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.detection import Detections, detect
from celnav.errors import CelnavError
from celnav.fix import Fix
from celnav.images import read_image
from celnav.solver import solve, solvers

EXIT_FIX, EXIT_REFUSAL, EXIT_BAD_INPUT = 0, 1, 2

_EXAMPLES = """\
examples:
  celnav solve frame-00000.png --camera frame-00000.json --attitude frame-00000.json \\
      --utc 2020-01-01T00:00:00Z
  celnav solve sky.jpg --camera camera.json --utc 2020-01-01T00:00:00Z --attitude zenith-north-up --json

exit status: 0 a fix, 1 a refusal (the reason is printed), 2 input that cannot be used
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="celnav",
        description="Where was this picture of the night sky taken?",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    command = commands.add_parser(
        "solve",
        help="latitude and longitude from one image",
        description="Latitude and longitude from one image of the night sky.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("image", metavar="IMAGE", help="PNG, JPEG or TIFF, 8 or 16 bits")
    command.add_argument("--camera", required=True, metavar="FILE", help="JSON: a camera, or a frame record")
    command.add_argument("--utc", required=True, help="middle of the exposure, such as 2020-01-01T00:00:00Z")
    command.add_argument(
        "--attitude",
        required=True,
        metavar="zenith-north-up|zenith|unknown|FILE",
        help="zenith-north-up: camera at the zenith with north at the top; zenith: heading unknown; unknown: lost in "
        "space, no position; or JSON with R_cam (ENU to camera), or a frame record",
    )
    command.add_argument("--solver", default="skybench", choices=solvers(), help="default: %(default)s")
    command.add_argument("--mask", metavar="FILE", help="image that is not black where pixels are NOT to be used")
    command.add_argument("--pressure-hpa", type=float, default=1010.0, help="for refraction; default: %(default)s")
    command.add_argument("--temperature-c", type=float, default=10.0, help="for refraction; default: %(default)s")
    command.add_argument("--dut1-s", type=float, help="UT1-UTC in seconds; default: from the IERS table")
    command.add_argument(
        "--time-limit-s",
        type=float,
        metavar="SECONDS",
        help="give the search for an identification up after so long; default: no limit but that of its work",
    )
    command.add_argument("--json", action="store_true", help="print JSON")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = _parser().parse_args(argv)
    try:
        fix, detections = _solve(arguments)
    except CelnavError as error:
        print(f"celnav: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    if arguments.json:
        text = json.dumps(fix.to_dict() | {"n_detections": len(detections)}, indent=2, allow_nan=False)
    else:
        text = _describe(fix, detections)
    try:
        print(text, flush=True)
    except BrokenPipeError:
        # The reader closed the pipe. The rest must not be written again when the interpreter ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return EXIT_FIX if fix.ok else EXIT_REFUSAL


def _solve(arguments: argparse.Namespace) -> tuple[Fix, Detections]:
    camera = Camera.from_json(arguments.camera)
    attitude: Attitude | None
    if arguments.attitude == "zenith-north-up":
        attitude = Attitude.zenith_north_up()
    elif arguments.attitude == "zenith":
        attitude = Attitude.up([0.0, 0.0, 1.0])
    elif arguments.attitude == "unknown":
        attitude = None
    else:
        attitude = Attitude.from_json(arguments.attitude)
    mask = None
    if arguments.mask is not None:
        values = read_image(arguments.mask)
        mask = values.astype(bool) if values.ndim == 2 else values.any(axis=2)
    detections = detect(read_image(arguments.image), mask)
    fix = solve(
        detections,
        camera,
        arguments.utc,
        attitude,
        arguments.solver,
        pressure_hpa=arguments.pressure_hpa,
        temperature_c=arguments.temperature_c,
        dut1_s=arguments.dut1_s,
        time_limit_s=arguments.time_limit_s,
    )
    return fix, detections


def _describe(fix: Fix, detections: Detections) -> str:
    """Say in a few lines what came out."""
    if not fix.ok:
        return f"no fix: {fix.reason} ({fix.message})\ndetections  {len(detections)}"
    lines = [
        f"latitude    {abs(fix.lat_deg):.5f} {'N' if fix.lat_deg >= 0 else 'S'}",
        f"longitude   {abs(fix.lon_deg):.5f} {'E' if fix.lon_deg >= 0 else 'W'}",
    ]
    if fix.cov_km2 is not None:
        east, north = np.sqrt(np.diag(fix.cov_km2))
        lines.append(f"uncertainty {1000 * east:.0f} m east, {1000 * north:.0f} m north (1 sigma, centroid noise)")
    lines += [
        f"stars       {len(fix.matches)} identified of {len(detections)} detected, {fix.residual_rms_px:.2f} px rms",
        f"confidence  {fix.confidence:.2f} ({fix.solver})",
        f"time        {fix.time_ms['total']:.0f} ms",
    ]
    return "\n".join(lines)
