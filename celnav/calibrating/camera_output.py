"""Output of a calibrated camera for other programs: OpenCV files and a scenario of the generator."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from celnav import projection
from celnav.camera import FISHEYE, Camera
from celnav.errors import CameraError

F8 = NDArray[np.float64]

_OPENCV_LENGTHS = (4, 5, 8, 12, 14)


def opencv_calibration(camera: Camera) -> tuple[F8, F8, bool]:
    """Return OpenCV's camera matrix (3, 3), distortion coefficients (n,), and whether they are for ``cv2.fisheye``.

    Raises
    ------
    CameraError
        When OpenCV has no such lens: a fisheye with decentring, thin prism or tilt, or with a law other than
        Kannala-Brandt's.
    """
    matrix = np.array([[camera.f_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
    if camera.model in ("kannala_brandt", "equidistant"):
        if any(camera.p) or any(camera.s) or any(camera.tilt_rad):
            raise CameraError(
                "OpenCV's fisheye has no decentring, thin prism or tilt: calibrate with --opencv-only to fit one without"
            )
        return matrix, np.array([*camera.k, 0.0, 0.0, 0.0, 0.0])[:4], True
    if camera.model not in ("pinhole", "brown_conrady"):
        raise CameraError(f"OpenCV has no lens of the model {camera.model}: calibrate with --opencv-only")
    k = (*camera.k, *[0.0] * 6)[:6]
    p, s = (*camera.p, 0.0, 0.0)[:2], (*camera.s, *[0.0] * 4)[:4]
    full = np.array([k[0], k[1], *p, *k[2:6], *s, *(*camera.tilt_rad, 0.0, 0.0)[:2]])
    length = next(n for n in _OPENCV_LENGTHS if not full[n:].any())
    return matrix, full[:length], False


def opencv_text(camera: Camera, *, yaml: bool) -> str:
    """Return a calibration as ``cv2.FileStorage`` writes it, YAML or JSON; `celnav.read_camera_file` reads both."""
    matrix, coefficients, fisheye = opencv_calibration(camera)
    content: dict[str, Any] = {"image_width": camera.width, "image_height": camera.height}
    if fisheye:
        content |= {"fisheye_model": 1, "distortion_model": "fisheye"}
    matrices = {"camera_matrix": matrix, "distortion_coefficients": coefficients.reshape(1, -1)}
    if not yaml:
        tagged = {name: {"type_id": "opencv-matrix", **_matrix(values)} for name, values in matrices.items()}
        return json.dumps(content | tagged, indent=1) + "\n"
    lines = ["%YAML:1.0", "---", *(f"{name}: {value}" for name, value in content.items())]
    for name, values in matrices.items():
        part = _matrix(values)
        lines += [f"{name}: !!opencv-matrix", f"   rows: {part['rows']}", f"   cols: {part['cols']}", "   dt: d"]
        lines.append(f"   data: [ {', '.join(f'{float(value)!r}' for value in part['data'])} ]")
    return "\n".join(lines) + "\n"


def _matrix(values: F8) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "dt": "d", "data": values.ravel().tolist()}


def scenario_text(
    camera: Camera,
    pointing: Mapping[str, float],
    site: Mapping[str, float],
    utc: str,
    exposure_s: float,
    reach_px: float | None = None,
) -> str:
    """Return a scenario of the generator (YAML) with this camera, its attitude, place and time.

    A calibration does not know the aperture, the sensor and the sky; the file has the generator's defaults, to be edited.
    `reach_px`, the distance of the outermost star from the principal point, becomes the image circle of a fisheye.
    """
    lens: dict[str, Any] = {"model": camera.model, "width": camera.width, "height": camera.height, "f_px": camera.f_px}
    if camera.fy_px != camera.f_px:
        lens["pixel_aspect"] = camera.fy_px / camera.f_px
    lens |= {"cx_px": camera.cx_px, "cy_px": camera.cy_px}
    lens |= {name: list(getattr(camera, name)) for name in ("k", "p", "s", "tilt_rad") if getattr(camera, name)}
    if reach_px is not None and camera.model in FISHEYE:
        lens["image_circle_px"] = round(min(reach_px + 1.0, _turning_px(camera) - 1.0), 1)
    lens["aperture_mm"] = 2.0
    sections: dict[str, Mapping[str, Any]] = {"site": site, "attitude": pointing, "camera": lens}
    lines = [
        "# A calibrated camera. Aperture, sensor and sky are not known to the calibration: set those of the camera and site.",
        "name: calibrated",
        "seed: 0",
        "time:",
        f"  utc_start: {utc}",
        f"  exposure_s: {_yaml(exposure_s)}",
    ]
    for title, section in sections.items():
        lines += [f"{title}:", *(f"  {name}: {_yaml(value)}" for name, value in section.items())]
    lines += ["sky:", "  bortle: 4"]
    return "\n".join(lines) + "\n"


def _yaml(value: object) -> str:
    """Write a value so that YAML 1.1 reads the same: a number with an exponent but no decimal point would be text."""
    return (
        re.sub(r"(?<![\d.])(-?\d+)e", r"\1.0e", json.dumps(value)) if not isinstance(value, str) else json.dumps(value)
    )


def _turning_px(camera: Camera) -> float:
    """Distance from the principal point at which the radius of a fisheye's law stops increasing, pixels."""
    law = cast("projection.Law", camera.model)
    limit = projection.largest_angle(law, camera.k)
    return float(camera.f_px * projection.radius_of(law, np.array([limit]), camera.k)[0])
