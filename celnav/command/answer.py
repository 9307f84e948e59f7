"""Output of `celnav solve`, for people and for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.command.field_limits import field_deg
from celnav.command.pointing import Pointing
from celnav.detections import Detections
from celnav.fix import Fix
from celnav.problem import ToldSigmas
from celnav.sky.astrometry import celestial_to_terrestrial, enu_rotation
from celnav.sky.catalog import load_catalog
from celnav.sky.earth_rotation import earth_orientation
from celnav.sky.planets import planet_name
from celnav.sky.star_names import star_name
from celnav.sky.utc import parse_utc
from celnav.sky.wgs84 import MEAN_RADIUS_KM, ROTATION_RAD_S, SEMI_MAJOR_AXIS_KM

F8 = NDArray[np.float64]
_KM_PER_DEG = math.radians(MEAN_RADIUS_KM)
_EQUATOR_KM_PER_S = ROTATION_RAD_S * SEMI_MAJOR_AXIS_KM
_LABEL = 12


@dataclass(frozen=True, eq=False)
class Answer:
    """The fix of one image, and the inputs and assumptions that it is based on.

    Attributes
    ----------
    fix : Fix
        Result of the solver.
    detections : Detections
        Detections in the image.
    camera : Camera or None
        The camera as supplied, before anything is fitted to the stars; None if it was to be found from the stars and was
        not.
    camera_from : str
        Source of the camera, in words.
    utc : str
        Middle of the exposure.
    attitude : Attitude or None
        The attitude as supplied.
    R_cam : ndarray, shape (3, 3), or None
        East-north-up to camera: from the stars if they give a position, else as supplied; None if the heading is unknown.
    assumed : tuple of str
        Assumptions that were made.
    warnings : tuple of str
        Reasons that make the answer doubtful, or prevent one.
    time_ms : mapping of str to float
        Time of each stage, and ``total`` for the whole command, milliseconds.
    sigmas : ToldSigmas
        Stated standard deviations of time, lens and air.
    """

    fix: Fix
    detections: Detections
    camera: Camera | None
    camera_from: str
    utc: str
    attitude: Attitude | None
    R_cam: F8 | None
    assumed: tuple[str, ...]
    warnings: tuple[str, ...]
    time_ms: Mapping[str, float]
    sigmas: ToldSigmas = field(default_factory=ToldSigmas)

    @property
    def pointing(self) -> Pointing | None:
        """Azimuth, altitude and roll of the boresight; None unless the full attitude is known."""
        return None if self.R_cam is None else Pointing.of(self.R_cam)


def attitude_of(fix: Fix, utc: str, dut1_s: float | None, given: Attitude | None) -> F8 | None:
    """Return the rotation from east-north-up to the camera, shape (3, 3), from the stars, else the supplied one."""
    if fix.ok and fix.R_icrs_to_camera is not None:
        instant = parse_utc(utc)
        to_terrestrial = celestial_to_terrestrial(instant, earth_orientation(instant, dut1_s))
        return np.asarray(fix.R_icrs_to_camera @ to_terrestrial.T @ enu_rotation(fix.lat_deg, fix.lon_deg).T)
    return given.R_cam if given is not None and given.kind == "rotation" else None


def match_names(fix: Fix) -> list[str]:
    """Return the name of the star or planet of every match."""
    catalog = load_catalog()
    ids = [int(star_id) for star_id in fix.matches[:, 1]]
    of_planets = {star_id: planet_name(star_id) or "" for star_id in ids}
    stars = [star_id for star_id in ids if not of_planets[star_id]]
    rows = catalog.rows_of(stars) if stars else np.empty(0, dtype=np.intp)
    named = {
        star: star_name(int(catalog.hip[row]), int(catalog.hr[row])) for star, row in zip(stars, rows, strict=True)
    }
    return [of_planets[star_id] or named[star_id] for star_id in ids]


def length_text(metres: float) -> str:
    """Format a length with two significant digits, in m or km."""
    if not metres > 0:
        return "0 m"
    value, unit = (metres, "m") if metres < 995 else (metres / 1000, "km")
    value = float(f"{value:.1e}")
    return f"{value:.{min(max(0, 1 - math.floor(math.log10(value))), 2)}f} {unit}"


def degree_decimals(sigma_km: float) -> int:
    """Return the number of decimals, in degrees, for a position with this standard deviation; the last is within it."""
    if not sigma_km > 0:
        return 5
    return min(max(math.ceil(-math.log10(sigma_km / _KM_PER_DEG)), 1), 7)


def position_texts(fix: Fix) -> tuple[str, str]:
    """Format latitude and longitude with as many digits as the uncertainty justifies."""
    sigma_km = 0.0 if fix.cov_km2 is None else float(np.sqrt(np.diag(fix.cov_km2)).min())
    decimals = degree_decimals(sigma_km)
    return (
        f"{abs(fix.lat_deg):.{decimals}f} {'N' if fix.lat_deg >= 0 else 'S'}",
        f"{abs(fix.lon_deg):.{decimals}f} {'E' if fix.lon_deg >= 0 else 'W'}",
    )


def map_link(fix: Fix) -> str:
    """Return the web address of a map of the position, as text only; no program opens it."""
    sigma_km = 1.0 if fix.cov_km2 is None else float(np.sqrt(np.diag(fix.cov_km2)).max())
    decimals = degree_decimals(sigma_km)
    lat, lon = f"{fix.lat_deg:.{decimals}f}", f"{fix.lon_deg:.{decimals}f}"
    zoom = min(max(round(math.log2(20000 / max(sigma_km, 0.01))), 4), 16)
    return f"https://www.openstreetmap.org/?mlat={lat}&mlon={lon}#map={zoom}/{lat}/{lon}"


def text_of(answer: Answer, matches: bool = False) -> str:
    """Format the answer in a few lines, with a table of the matches below them if wanted."""
    fix, pointing = answer.fix, answer.pointing
    lines: list[tuple[str, str]] = []
    if fix.ok:
        latitude, longitude = position_texts(fix)
        lines += [("latitude", latitude), ("longitude", longitude), *_uncertainty(answer), ("map", map_link(fix))]
    else:
        lines += [("no fix", f"{fix.reason} ({fix.message})")]
    if pointing is not None:
        lines.append(("boresight", _pointing_text(pointing) + ("" if fix.ok else " (as given)")))
    elif fix.R_icrs_to_camera is not None and answer.camera is not None:
        lines.append(("boresight", _celestial_text(fix.R_icrs_to_camera)))
        lines += _middle_line(answer.camera, fix.R_icrs_to_camera)
    lines += _camera_lines(answer)
    if len(fix.matches):
        scatter = "" if math.isnan(fix.residual_rms_px) else f", {fix.residual_rms_px:.2f} px rms"
        lines.append(("stars", f"{len(fix.matches)} identified of {_counted(answer.detections)}{scatter}"))
        lines.append(("confidence", f"{fix.confidence:.2f} ({fix.solver})"))
    else:
        lines.append(("stars", f"none identified of {_counted(answer.detections)}"))
    lines.append(("time", _time_text(answer.time_ms)))
    lines += [("assumed", sentence) for sentence in answer.assumed]
    lines += [("warning", sentence) for sentence in answer.warnings]
    written, before = [], ""
    for label, value in lines:
        written.append(f"{'' if label == before else label:{_LABEL}}{value}")
        before = label
    if matches:
        written += ["", *_match_table(answer)]
    return "\n".join(written)


def _counted(detections: Detections) -> str:
    """Return the number of detections in words."""
    fainter = f" and {detections.n_faint} fainter than the threshold" if detections.n_faint else ""
    return f"{len(detections) - detections.n_faint} detected{fainter}"


def json_of(answer: Answer, matches: bool = False) -> str:
    """Format the answer as JSON with one line per key and, if wanted, one line per match."""
    fix = answer.fix
    content = fix.to_dict()
    content["n_matches"], content["n_detections"] = len(fix.matches), len(answer.detections)
    content["n_faint_detections"] = answer.detections.n_faint
    del content["matches"], content["residuals_px"]
    content["solver_time_ms"] = content["time_ms"]
    content["time_ms"] = {stage: round(float(ms), 3) for stage, ms in answer.time_ms.items()}
    pointing = answer.pointing
    content |= {
        "R_cam": None if answer.R_cam is None else answer.R_cam.round(12).tolist(),
        "pointing": None if pointing is None else {name: round(angle, 6) for name, angle in asdict(pointing).items()},
        "map": map_link(fix) if fix.ok else None,
        "utc": answer.utc,
        "camera": None if answer.camera is None else asdict(answer.camera),
        "camera_from": answer.camera_from,
        "field_deg": None if answer.camera is None else [round(angle, 3) for angle in field_deg(answer.camera)],
        "assumed": list(answer.assumed),
        "warnings": list(answer.warnings),
    }
    lines = [f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in content.items()]
    if matches:
        rows = ",\n".join(f"    {json.dumps(row, allow_nan=False)}" for row in _match_rows(answer))
        lines.append(f'  "matches": [\n{rows}\n  ]' if rows else '  "matches": []')
    return "{\n" + ",\n".join(lines) + "\n}"


def _uncertainty(answer: Answer) -> list[tuple[str, str]]:
    fix, attitude = answer.fix, answer.attitude
    tilted = attitude is not None and attitude.tilt_deg > 0
    stated = tilted or (attitude is not None and attitude.kind == "rotation" and attitude.heading_deg > 0)
    if fix.cov_km2 is None or answer.camera is None:
        return []
    east, north = (length_text(1000 * sigma) for sigma in np.sqrt(np.diag(fix.cov_km2)))
    of = "scatter of the stars and the attitude's sigma" if stated else "scatter of the stars"
    told = answer.sigmas
    beside = []
    if told.utc_s > 0:
        of = f"{of}, {told.utc_s:g} s of time"
    else:
        beside.append(f"1 s of time ({length_text(1000 * _EQUATOR_KM_PER_S * math.cos(math.radians(fix.lat_deg)))})")
    if not tilted:
        beside.append(f"0.01 deg of the vertical ({length_text(10 * _KM_PER_DEG)})")
    if answer.camera.uncertainty is None and not (told.focal and told.centre_px and fix.solver == "skybench"):
        beside.append("errors of the camera")
    else:
        of = f"{of}, errors of the camera"
    lines = [("uncertainty", f"{east} east, {north} north (1 sigma: {of})")]
    return [*lines, ("uncertainty", f"not in it: {', '.join(beside)}")] if beside else lines


def _pointing_text(pointing: Pointing) -> str:
    return f"azimuth {pointing.azimuth_deg:.2f}, altitude {pointing.altitude_deg:.2f}, roll {pointing.roll_deg:.2f} deg"


def _middle_line(camera: Camera, R_icrs_to_camera: F8) -> list[tuple[str, str]]:
    """Describe the direction of the image's centre, if the axis of the lens is elsewhere."""
    middle = np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
    if (
        np.hypot(*(middle[0] - [camera.cx_px, camera.cy_px])) < 1
        or not np.isfinite(ray := camera.to_rays(middle)[0]).all()
    ):
        return []
    x, y, z = R_icrs_to_camera.T @ ray
    ra_deg, dec_deg = math.degrees(math.atan2(y, x)) % 360, math.degrees(math.asin(max(-1.0, min(1.0, z))))
    return [("middle", f"of the image: right ascension {ra_deg:.3f}, declination {dec_deg:+.3f} deg")]


def _celestial_text(R_icrs_to_camera: F8) -> str:
    """Describe the celestial position of the boresight, and the position angle of the image's top, north through east."""
    _, down, axis = R_icrs_to_camera
    ra, dec = math.atan2(axis[1], axis[0]), math.asin(max(-1.0, min(1.0, axis[2])))
    east = np.array([-math.sin(ra), math.cos(ra), 0.0])
    turned = math.degrees(math.atan2(-float(down @ east), -float(down @ np.cross(axis, east)))) % 360
    return (
        f"right ascension {math.degrees(ra) % 360:.3f}, declination {math.degrees(dec):+.3f} deg (ICRS), "
        f"top of the image at position angle {turned:.2f} deg"
    )


def _time_text(time_ms: Mapping[str, float]) -> str:
    parts = ", ".join(f"{stage} {ms / 1000:.2f}" for stage, ms in time_ms.items() if stage != "total")
    return f"{time_ms['total'] / 1000:.2f} s in all: {parts}"


def _camera_lines(answer: Answer) -> list[tuple[str, str]]:
    """Describe the camera, and the corrections of the solver to it."""
    camera = answer.camera
    if camera is None:
        return [("camera", answer.camera_from)]
    width, height = field_deg(camera)
    lines = [("camera", f"{answer.camera_from}: {camera.model}, {camera.f_px:.1f} px, {width:.3g} x {height:.3g} deg")]
    if calibrated := _calibration_text(answer.fix):
        lines.append(("camera", calibrated))
    return lines


def _calibration_text(fix: Fix) -> str:
    """Describe the corrections of the solver to the camera."""
    found, parts = fix.calibration, []
    if found.log_f is not None:
        parts.append(f"focal length {_signed(100 * math.expm1(found.log_f.value), 2)} %")
    if found.cx_px is not None and found.cy_px is not None:
        parts.append(f"principal point ({_signed(found.cx_px.value, 1)}, {_signed(found.cy_px.value, 1)}) px")
    if found.q1 is not None and found.q2 is not None:
        parts.append(f"distortion at the corner {_signed(100 * (found.q1.value + found.q2.value), 2)} %")
    return f"fitted to the stars: {', '.join(parts)}" if parts else ""


def _signed(value: float, decimals: int) -> str:
    """Format a number with its sign; a negative number that rounds to zero loses its sign."""
    return f"{round(value, decimals) + 0.0:+.{decimals}f}"


def _match_rows(answer: Answer) -> list[dict[str, Any]]:
    fix, uv = answer.fix, answer.detections.uv
    residuals = fix.residuals_px
    rows = []
    for place, (row, star_id), name in zip(
        range(len(fix.matches)), fix.matches.tolist(), match_names(fix), strict=True
    ):
        found = {"detection": row, "u_px": round(float(uv[row, 0]), 3), "v_px": round(float(uv[row, 1]), 3)}
        off = None if residuals is None else [round(float(value), 3) for value in residuals[place]]
        rows.append(found | {"star_id": star_id, "name": name, "residual_px": off})
    return rows


def _match_table(answer: Answer) -> list[str]:
    lines = [f"{'u_px':>9} {'v_px':>9} {'star_id':>9} {'du_px':>7} {'dv_px':>7}  name"]
    for row in _match_rows(answer):
        du, dv = row["residual_px"] or (math.nan, math.nan)
        lines.append(f"{row['u_px']:9.2f} {row['v_px']:9.2f} {row['star_id']:9d} {du:7.2f} {dv:7.2f}  {row['name']}")
    return lines


def printable(text: str, kept: str = "\n") -> str:
    r"""Escape every character that is not printable as Python does (``\x1b``), except for those that are kept.

    Parameters
    ----------
    text : str
        The text.
    kept : str
        Characters that stay unchanged; empty for text that must be a single line, whatever the names in it contain.
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() or letter in kept else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )
