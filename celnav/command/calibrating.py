"""``celnav calibrate``: from the arguments to files and a report."""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from celnav.command.camera_file import read_camera_file
from celnav.command.checks.remedies import naming_formats
from celnav.command.pointing import Pointing
from celnav.command.whole_file import write_whole
from celnav.errors import ConfigError
from celnav.reading.image_file import read_mask


def calibrate_files(arguments: argparse.Namespace) -> str:
    """Calibrate from the frames named by the arguments, write the requested files, and return the report.

    Raises
    ------
    CelnavError
        For input that cannot be used.
    """
    from celnav.calibrating.calibrate import calibrate
    from celnav.calibrating.camera_output import opencv_text, scenario_text
    from celnav.calibrating.joint_fit import NothingNamedError
    from celnav.calibrating.verdict import report
    from celnav.command.calibration_frames import FEWEST_FOR_MASK, first_shape, learnt_mask, read_frames
    from celnav.command.residual_map import check_map_path, draw_residual_map
    from celnav.unknown_camera import WIDER_SIGMAS_PX

    if arguments.map is not None:
        check_map_path(arguments.map)
    for option, path in (
        ("--out", arguments.out),
        ("--opencv", arguments.opencv),
        ("--scenario", arguments.scenario),
        ("--mask-out", arguments.mask_out),
    ):
        if path is not None and not Path(path).resolve().parent.is_dir():
            raise ConfigError(f"{option} {path}: its folder does not exist")
    with naming_formats():
        mask = None if arguments.mask is None else read_mask(arguments.mask, first_shape(arguments.frames))
    if arguments.mask_out is not None and mask is None:
        mask = learnt_mask(arguments.frames)
        if mask is None:
            raise ConfigError(
                f"--mask-out: a mask is learnt from {FEWEST_FOR_MASK} images or more, between which the sky turned: "
                "add images, or give --mask"
            )
    widths = (None,) if all(path.endswith(".json") for path in arguments.frames) else (None, *WIDER_SIGMAS_PX)
    for sigma_px in widths:
        with naming_formats():
            frames = read_frames(
                arguments.frames, arguments.utc, arguments.time_zone, arguments.exif_time_is, mask, sigma_px
            )
        guess = None if arguments.camera is None else read_camera_file(arguments.camera, frames[0].size).camera
        try:
            found = calibrate(
                frames,
                arguments.lat,
                arguments.lon,
                height_m=arguments.height_m,
                pressure_hpa=arguments.pressure_hpa,
                temperature_c=arguments.temperature_c,
                camera=guess,
                models=arguments.models,
                opencv_only=arguments.opencv_only or arguments.opencv is not None,
                mount=arguments.mount,
                dut1_s=arguments.dut1_s,
            )
            break
        except NothingNamedError:
            if sigma_px == widths[-1]:
                raise
    write_whole(arguments.out, found.to_json(), "--out")
    if arguments.opencv is not None:
        text = opencv_text(found.camera, yaml=not arguments.opencv.lower().endswith(".json"))
        write_whole(arguments.opencv, text, "--opencv")
    if arguments.scenario is not None:
        pointing = Pointing.of(found.mount.R_cam)
        angles = {
            "azimuth_deg": pointing.azimuth_deg,
            "altitude_deg": pointing.altitude_deg,
            "roll_deg": pointing.roll_deg,
        }
        site = {"latitude_deg": arguments.lat, "longitude_deg": arguments.lon, "height_m": arguments.height_m}
        first = found.attitudes[0]
        exposure_s = 1.0 if first.exposure_s is None else first.exposure_s
        started_mjd = first.utc.mjd - exposure_s / 2 / 86400
        moment = np.datetime64("1858-11-17T00:00:00") + np.timedelta64(round(started_mjd * 86_400_000), "ms")
        centre = np.array([found.camera.cx_px, found.camera.cy_px])
        reach_px = float(np.hypot(*(found.residuals.uv - centre).T).max())
        text = scenario_text(found.camera, angles, site, f"{moment}Z", exposure_s, reach_px)
        write_whole(arguments.scenario, text, "--scenario")
    if arguments.mask_out is not None and mask is not None:
        write_whole(arguments.mask_out, _mask_picture(mask), "--mask-out")
    if arguments.map is not None:
        draw_residual_map(found, arguments.map)
    return found.to_json().rstrip("\n") if arguments.json else report(found)


def _mask_picture(mask: NDArray[np.bool_]) -> bytes:
    """Return a PNG that is white where pixels are not used."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).save(content, format="PNG")
    return content.getvalue()
