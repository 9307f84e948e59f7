"""Reading of camera files: celnav's own JSON, frame records, OpenCV and ROS calibrations (YAML, JSON), and RMS platepars.

Like celnav, OpenCV puts pixel centres at integers (docs/conventions.md), so its principal point is used as it is.
"""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from celnav import projection
from celnav.camera import FISHEYE, Camera
from celnav.command.platepar import has_distortion, lens_of_platepar
from celnav.errors import CameraError

MAX_BYTES = 16_000_000
_MOST_NUMBERS = 1000
_MATRIX_NAMES = ("camera_matrix", "cameraMatrix", "K", "k", "mtx")
_PLATEPAR_NAMES = ("F_scale", "X_res", "Y_res")
_DISTORTION_NAMES = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D", "d", "dist")
_LIKE_DISTORTION = re.compile(
    r"(?!undist)\w*distort\w*|dist(_?(coef|param|vec)\w*)?|\w*coef\w*|(?-i:[kp][1-8])|xi", re.IGNORECASE
)
_FISHEYE_NAMES = ("equidistant", "fisheye", "kannala_brandt", "kannalabrandt")
_PERSPECTIVE_NAMES = ("", "plumb_bob", "rational_polynomial", "brown_conrady", "none", "pinhole")
_YAML_CORE = "tag:yaml.org,2002:"
_YAML_OPENCV = f"{_YAML_CORE}opencv-matrix"
_YAML_LEADING_ZERO = "tag:celnav,leading-zero"
# Numbers as in YAML 1.2 (10.3.2), where 1e3 needs neither a point nor a sign; YAML 1.1 reads 10:30 to base 60.
_YAML_NUMBERS = (
    (_YAML_LEADING_ZERO, re.compile(r"[-+]?0[0-9]+$"), "-+0"),
    (f"{_YAML_CORE}int", re.compile(r"[-+]?(?:0|[1-9][0-9]*)$"), "-+0123456789"),
    (
        f"{_YAML_CORE}float",
        re.compile(
            r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
        ),
        "-+0123456789.",
    ),
)
_YAML_REPLACED = {f"{_YAML_CORE}{name}" for name in ("int", "float", "timestamp")}


@dataclass(frozen=True)
class CameraFile:
    """A camera read from a file.

    Attributes
    ----------
    camera : Camera
        The camera.
    kind : str
        Kind of file, in words.
    assumed : tuple of str
        Assumptions on what the file does not state, a sentence each.
    """

    camera: Camera
    kind: str
    assumed: tuple[str, ...] = ()


def read_camera_file(path: str | Path, size: tuple[int, int] | None = None) -> CameraFile:
    """Read a camera from a file.

    Parameters
    ----------
    path : str or Path
        JSON: a camera (with ``f_px`` or ``hfov_deg``) or a frame record; YAML or JSON: a calibration of OpenCV
        (``FileStorage``, or plain lists under ``camera_matrix``), a ``camera_info`` of ROS, or a platepar of RMS.
    size : tuple of int, optional
        Width and height of the image, for files that do not give them.

    Returns
    -------
    CameraFile
        The camera, the kind of file, and the assumptions.

    Raises
    ------
    CameraError
        When the file cannot be read, lacks a value, or describes a lens for which celnav has no model.
    """
    record = _tree(Path(path))
    try:
        if "camera" in record:
            inner = record["camera"]
            if not isinstance(inner, Mapping):
                raise CameraError("camera must be an object with model, width, height and f_px")
            of = "calibration" if "calibration" in record else "frame record"
            return CameraFile(_own(inner, size), f"camera of a {of}")
        if any(key in record for key in ("model", "f_px", "hfov_deg")):
            return CameraFile(_own(record, size), "camera", _size_assumed(record, "width"))
        if any(key in record for key in _MATRIX_NAMES):
            return _calibration(record, size)
        if all(key in record for key in _PLATEPAR_NAMES):
            return _platepar(record)
    except CameraError as error:
        raise CameraError(f"camera file {path}: {error}") from None
    raise CameraError(
        f"camera file {path} holds no camera: it needs model, width, height and f_px (or hfov_deg), or camera_matrix and "
        "distortion_coefficients as OpenCV writes them"
    )


def camera_of_field(model: str, width: int, height: int, hfov_deg: float, k: tuple[float, ...] = ()) -> Camera:
    """Make a camera from its horizontal field of view, edge to edge through the centre.

    Parameters
    ----------
    model : str
        One of `celnav.camera.MODELS`.
    width, height : int
        Size of the frame, pixels.
    hfov_deg : float
        Field of view, degrees.
    k : tuple of float
        Distortion coefficients for `kannala_brandt`.

    Raises
    ------
    CameraError
        When the model cannot show such a field, or is `brown_conrady`, whose focal length does not follow from the field.
    """
    if isinstance(hfov_deg, bool) or not isinstance(hfov_deg, (int, float)) or not 0 < hfov_deg < 360:
        raise CameraError(f"hfov_deg = {hfov_deg!r} must be a number of degrees between 0 and 360")
    if model == "pinhole":
        return Camera.pinhole(width, height, hfov_deg)
    unit = Camera(model, width, height, 1.0, k=k)
    if model not in FISHEYE:
        raise CameraError(f"hfov_deg does not give the focal length of the model {model}: give f_px")
    law = cast("projection.Law", model)
    half = np.array([math.radians(hfov_deg) / 2])
    if not half[0] <= projection.largest_angle(law, unit.k):
        raise CameraError(f"hfov_deg = {hfov_deg:g} is more than the model {model} can show")
    radius = float(projection.radius_of(law, half, unit.k)[0])
    return Camera(model, width, height, width / 2 / radius, k=k)


def _tree(path: Path) -> Mapping[str, Any]:
    """Read JSON or YAML; YAML may contain the first line and the matrices of OpenCV's ``FileStorage``."""
    try:
        data = path.read_bytes() if path.stat().st_size <= MAX_BYTES else None
    except OSError as error:
        raise CameraError(f"cannot read camera file {path}: {error.strerror}") from None
    if data is None:
        raise CameraError(f"camera file {path} is larger than {MAX_BYTES // 1_000_000} MB: is it a calibration?")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise CameraError(f"camera file {path} is not a text file") from None
    try:
        record = _json_or_yaml(text, path.suffix.lower() == ".json")
    except (ValueError, RecursionError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CameraError(f"camera file {path} is neither JSON nor YAML: {first}") from None
    if not isinstance(record, Mapping):
        raise CameraError(
            f"camera file {path} must hold an object with model, width, height and f_px, or a calibration"
        )
    return record


def _json_or_yaml(text: str, is_json: bool) -> object:
    if is_json or text.lstrip().startswith("{"):
        try:
            return json.loads(text)
        except ValueError:
            if is_json:
                raise
    return _parse_yaml(text)


def _parse_yaml(text: str) -> object:
    """Return the content of a YAML text.

    Raises
    ------
    ValueError
        The text is no YAML, or has an alias, a tag other than OpenCV's, or a number with a leading zero; the message names
        the line.
    """
    import yaml

    # OpenCV writes "%YAML:1.0", which is not a YAML directive.
    if text.startswith("%YAML:"):
        text = text.partition("\n")[2]
    try:
        return yaml.load(text, Loader=_loader())
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error)
        raise ValueError(f"{problem}" + (f" in line {mark.line + 1}" if mark else "")) from None


@functools.cache
def _loader() -> Any:
    """Safe loader with the one tag that OpenCV writes, and without aliases, which can expand 400 bytes to gigabytes."""
    import yaml  # only cameras in YAML need it

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            event: Any = self.peek_event()  # type: ignore[no-untyped-call]
            problem = ""
            if isinstance(event, yaml.AliasEvent):
                problem = f"the alias *{event.anchor} is not read: write its value in its place"
            elif isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag not in (
                None,
                _YAML_OPENCV,
            ):
                tag = str(event.tag).replace(_YAML_CORE, "!!", 1)[:40]
                problem = f"the tag {tag} is not read: leave only the value"
            if problem:
                raise yaml.constructor.ConstructorError(None, None, problem, event.start_mark)
            return super().compose_node(parent, index)

    def matrix(loader: Loader, node: yaml.MappingNode) -> dict[Any, Any]:
        return loader.construct_mapping(node, deep=True)

    def refuse_leading_zero(loader: Loader, node: yaml.ScalarNode) -> Any:
        del loader
        sign = "-" if node.value[0] == "-" else ""
        digits = node.value.lstrip("+-0") or "0"
        problem = f"found {node.value[:40]}, which YAML may read as octal: write {sign}{digits[:40]}"
        raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)

    Loader.yaml_implicit_resolvers = {
        letter: [(tag, pattern) for tag, pattern in resolvers if tag not in _YAML_REPLACED]
        for letter, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    for tag, pattern, first in _YAML_NUMBERS:
        Loader.add_implicit_resolver(tag, pattern, list(first))
    Loader.add_constructor(_YAML_LEADING_ZERO, refuse_leading_zero)
    Loader.add_constructor(_YAML_OPENCV, matrix)
    return Loader


def _own(record: Mapping[str, Any], size: tuple[int, int] | None) -> Camera:
    """Read celnav's own format, in which ``hfov_deg`` may replace ``f_px``."""
    known = {str(name): value for name, value in record.items() if value is not None}
    # `Camera` takes NaN as a value that is not given.
    for name, value in known.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise CameraError(f"{name} = {value} must be a finite number; leave it out where it is not known")
    if size is not None and "width" not in known and "height" not in known:
        known["width"], known["height"] = size
    if "hfov_deg" not in known:
        return Camera.from_dict(known)
    if "f_px" in known or "fy_px" in known:
        raise CameraError("give f_px or hfov_deg, not both")
    hfov_deg = known.pop("hfov_deg")
    known.setdefault("model", "pinhole")
    # First check the camera as a whole; its focal length then follows from the field.
    checked = Camera.from_dict(known | {"f_px": 1.0})
    found = camera_of_field(checked.model, checked.width, checked.height, hfov_deg, checked.k)
    return Camera.from_dict(known | {"f_px": found.f_px})


def _calibration(record: Mapping[str, Any], size: tuple[int, int] | None) -> CameraFile:
    """Read an OpenCV or ROS calibration."""
    width, height = _size(record, size)
    key = next(name for name in _MATRIX_NAMES if name in record)
    matrix = _numbers(record[key], key)
    if matrix.size != 9:
        raise CameraError(f"{key} has {matrix.size} numbers; it must be a 3 x 3 matrix")
    (fx, skew, cx), (zero, fy, cy), last = matrix.reshape(3, 3)
    if abs(skew) > 1e-9 or zero != 0 or not np.allclose(last, [0, 0, 1]):
        raise CameraError(f"{key} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; a skew is not supported")
    if unknown := [str(name) for name, value in record.items() if value is not None and _may_be_distortion(str(name))]:
        raise CameraError(
            f"{unknown[0][:40]} looks like a distortion and is not known: name the coefficients one of "
            f"{', '.join(_DISTORTION_NAMES)}, the model distortion_model, or remove it"
        )
    key = next((name for name in _DISTORTION_NAMES if name in record), "")
    distortion = _numbers(record[key], key) if key else np.empty(0)
    lens = Camera("pinhole", width, height, float(fx), float(fy), float(cx), float(cy))
    assumed = list(_size_assumed(record, "image_width", "width"))
    if _is_fisheye(record):
        if distortion.size > 4:
            raise CameraError(f"{key} has {distortion.size} numbers; a fisheye of OpenCV has 4")
        camera = replace(lens, model="kannala_brandt", k=tuple(distortion.tolist()))
        return CameraFile(camera, "calibration of an OpenCV fisheye", tuple(assumed))
    if distortion.size not in (0, 4, 5, 8, 12, 14):
        raise CameraError(f"{key} has {distortion.size} numbers; OpenCV writes 4, 5, 8, 12 or 14")
    k1, k2, p1, p2, k3, k4, k5, k6, *rest = np.append(distortion, np.zeros(14))[:14].tolist()
    if distortion.size == 4 and "distortion_model" not in record and "fisheye_model" not in record:
        assumed.append(
            "the four distortion coefficients are k1, k2, p1, p2 of a perspective lens; for a fisheye add "
            "distortion_model: fisheye"
        )
    prism, tilt = (tuple(part) if any(part) else () for part in (rest[:4], rest[4:]))
    camera = replace(lens, model="brown_conrady", k=(k1, k2, k3, k4, k5, k6), p=(p1, p2), s=prism, tilt_rad=tilt)
    return CameraFile(camera, "calibration of OpenCV", tuple(assumed))


def _may_be_distortion(name: str) -> bool:
    """Return whether an unread key may hold distortion: ``distortion_coeffs`` of Kalibr, ``distCoeff``, ``k1``."""
    return name not in (*_MATRIX_NAMES, *_DISTORTION_NAMES, "distortion_model") and bool(
        _LIKE_DISTORTION.fullmatch(name)
    )


def _platepar(record: Mapping[str, Any]) -> CameraFile:
    """Read the lens of an RMS platepar; if it states no distortion, its scale only, as a start for `celnav.calibrate`."""
    kind = "platepar of RMS"
    if has_distortion(record):
        found = lens_of_platepar(record)
        left = f"{found.rms_px:.2g} px rms, {found.largest_px:.2g} px at most"
        return CameraFile(found.camera, kind, (f"the lens fitted to the platepar's distortion leaves {left}",))
    numbers = _numbers([record[name] for name in _PLATEPAR_NAMES], ", ".join(_PLATEPAR_NAMES))
    scale, width, height = (float(number) for number in numbers)
    if width != int(width) or height != int(height):
        raise CameraError("X_res and Y_res must be whole numbers of pixels")
    camera = Camera("equidistant", int(width), int(height), math.degrees(scale))
    return CameraFile(camera, kind, ("of the platepar the scale alone is used: it states no distortion",))


def _is_fisheye(record: Mapping[str, Any]) -> bool:
    """Return whether a calibration is for OpenCV's ``fisheye``, which ROS calls equidistant."""
    if record.get("fisheye_model") not in (None, 0, False):
        return True
    model = str(record.get("distortion_model") or "").strip().lower()
    if model not in (*_FISHEYE_NAMES, *_PERSPECTIVE_NAMES):
        raise CameraError(
            f"distortion_model {model[:40]!r} is not known; known: {', '.join(name for name in _PERSPECTIVE_NAMES if name)}, "
            f"{', '.join(_FISHEYE_NAMES)}"
        )
    return model in _FISHEYE_NAMES


def _size(record: Mapping[str, Any], size: tuple[int, int] | None) -> tuple[int, int]:
    for names in (("image_width", "image_height"), ("width", "height")):
        if all(name in record for name in names):
            return record[names[0]], record[names[1]]
    for name in ("image_size", "imageSize"):
        if name in record:
            values = _numbers(record[name], name)
            if values.size != 2 or (values % 1).any():
                raise CameraError(f"{name} must be width and height")
            return int(values[0]), int(values[1])
    if size is None:
        raise CameraError("the calibration does not say how large its images are: add image_width and image_height")
    return size


def _size_assumed(record: Mapping[str, Any], *names: str) -> tuple[str, ...]:
    if any(name in record for name in (*names, "image_size", "imageSize")):
        return ()
    return ("the camera file gives no size of its images: they are as large as this one",)


def _numbers(value: object, key: str) -> NDArray[np.float64]:
    """Return the numbers of a matrix in OpenCV's form (``data``), or of nested lists; shape (n,)."""
    if isinstance(value, Mapping):
        value = value.get("data")
    count, parts = 0, [value]
    while parts:
        part = parts.pop()
        if isinstance(part, list):
            count += len(part)
            if count > _MOST_NUMBERS:
                raise CameraError(f"{key} has more than {_MOST_NUMBERS} numbers, which no camera has")
            parts += part
    try:
        numbers = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise CameraError(f"{key} must be a matrix of numbers") from None
    if not np.isfinite(numbers).all():
        raise CameraError(f"{key} must hold finite numbers")
    return numbers
