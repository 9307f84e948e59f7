"""``celnav solve``: from the arguments to an answer."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from celnav.adjustment import CameraPriors
from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.checking import shown
from celnav.command.answer import Answer, attitude_of
from celnav.command.attitude_option import is_of_gravity, read_attitude
from celnav.command.camera_file import read_camera_file
from celnav.command.checks.remedies import check_size, naming_attitudes, naming_formats
from celnav.command.exif import PhotoTags, read_tags, tags_of_fits
from celnav.command.exposure_time import exposure_time, refuse_clock_options
from celnav.command.field_limits import field_limit
from celnav.command.photo_camera import photo_camera
from celnav.command.sigma_option import read_sigmas
from celnav.detection import FAINT_STARS, DetectionConfig, detect
from celnav.detections import Detections
from celnav.errors import CalibrationError, CameraError, CelnavError, ConfigError
from celnav.fix import Fix, Reason
from celnav.lens.lens_uncertainty import LensUncertainty
from celnav.position import usual_weather
from celnav.problem import LastKnown, Solver
from celnav.reading.fits_file import is_fits, read_fits
from celnav.reading.image_file import read_image, read_mask, refuse_raw, without_blanks
from celnav.skybench_config import SkybenchConfig
from celnav.skybench_solver import SkybenchSolver
from celnav.solver import solve
from celnav.uncertainty.contradicted import WIDE_SCATTER_PX

if TYPE_CHECKING:
    from celnav.unknown_camera import FoundCamera

NAMES_NO_STAR = (Reason.NO_HYPOTHESIS, Reason.EFFORT_SPENT)
FEWEST_TO_MIRROR = 12
"""Number of detections from which a search of the mirror image is worthwhile."""
MIRRORED = (
    "the stars are those of a mirrored picture: turn it over, rows from the bottom up (as programs that write FITS files may "
    "have them) or columns from the right"
)
VERTICAL_WANTED = (
    "the stars are identified; a position needs the vertical too, such as --attitude altitude=45,roll=0, or --attitude "
    "zenith of a camera that looks straight up"
)

UNKNOWN = "unknown"
"""Value used instead of a camera file if nothing is known of the camera."""
Mode = Literal["none", "auto", "full"]
# Standard deviations for an uncalibrated lens: equivalent focal lengths are rounded to a millimetre, principal points are
# within a per cent of the width from the centre, and lenses that are not very wide distort by a few per cent at the corner.
UNCALIBRATED_FOCAL, UNCALIBRATED_CENTRE, UNCALIBRATED_DISTORTION = 0.05, 0.01, 0.05
UNCALIBRATED_DECENTRING = 3e-4
"""Standard deviation of each decentring term of an uncalibrated lens; the calibrated lens of a meteor station has 2.6e-4 and
-3.6e-4 (docs/real_frames.md)."""


@dataclass
class _Clock:
    """Timer for the stages of the command."""

    time_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.time_ms[name] = 1000 * (time.perf_counter() - begun)


@dataclass(frozen=True)
class _Lens:
    """The camera, its source, whether it has been calibrated, and whether it follows from tags or a stated focal length."""

    camera: Camera
    described: str
    calibrated: bool
    assumed: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    of_tags: bool = False


def answer(arguments: argparse.Namespace, started_s: float) -> Answer:
    """Solve the image named by the arguments.

    Parameters
    ----------
    arguments : Namespace
        Arguments from `celnav.command.arguments.parser`.
    started_s : float
        Value of `time.perf_counter` when the command began.

    Raises
    ------
    CelnavError
        For input that cannot be used.
    """
    clock = _Clock({"start": 1000 * (time.perf_counter() - started_s)})
    refuse_raw(arguments.image)
    if arguments.plot is not None:
        from celnav.command.plot import check_plot_path

        check_plot_path(arguments.plot)
    with clock.stage("reading"), naming_formats():
        image, tags = _image_and_tags(arguments.image)
        near = _near(arguments.near, arguments.solver)
        sigmas = read_sigmas(arguments.sigma)
        told = None if _nothing_told(arguments, tags) else _lens(arguments, tags)
        refuse_clock_options(arguments.image, arguments.time_zone, arguments.exif_time_is)
        moment = exposure_time(tags, arguments.utc, arguments.time_zone, arguments.exif_time_is)
        with naming_attitudes(arguments.attitude):
            attitude = read_attitude(arguments.attitude, tags.up, moment.utc)
        image, mask = without_blanks(image, None if arguments.mask is None else read_mask(arguments.mask, image.shape))
        air = usual_weather(arguments.height_m, arguments.pressure_hpa, arguments.temperature_c)
        if told is not None:
            check_size(told.camera, image.shape)
    if told is None:
        from celnav.unknown_camera import find_camera

        try:
            with clock.stage("finding the camera"):
                lens, detections = _found_lens(find_camera(image, moment.utc, mask))
        except CalibrationError as error:  # no star is identified, or the picture is mirrored
            fix = Fix.refusal(Reason.NO_HYPOTHESIS, str(error))
            found = Answer(
                fix=replace(fix, solver=arguments.solver),
                detections=detect(image, mask),
                camera=None,
                camera_from="not found from the stars",
                utc=moment.utc,
                attitude=attitude,
                R_cam=attitude_of(fix, moment.utc, arguments.dut1_s, attitude),
                assumed=(*moment.assumed, *_of_attitude(arguments.attitude, attitude, tags)),
                warnings=(),
                time_ms=clock.time_ms,
                sigmas=sigmas,
            )
            return _finished(found, image, arguments.plot, clock, started_s)
    else:
        lens = told
        with clock.stage("detection"):
            detections = detect(image, mask, DetectionConfig(faint_stars=FAINT_STARS))
    mode = _mode(arguments, lens, fitted=told is None and attitude is None)
    if mode == "full" and not lens.calibrated:
        lens = replace(lens, camera=perhaps_decentred(lens.camera))
    with clock.stage("solving"):
        fix = solve(
            detections,
            lens.camera,
            moment.utc,
            attitude,
            _solver(arguments, lens, mode),
            pressure_hpa=air.pressure_hpa,
            temperature_c=air.temperature_c,
            dut1_s=arguments.dut1_s,
            near=near,
            time_limit_s=arguments.time_limit_s,
            sigmas=sigmas,
        )
        stars = detections.without_faint()
        fix = _with_hint_of_a_mirror(fix, stars, lens.camera, moment.utc, arguments.time_limit_s, arguments.dut1_s)
        fix = _with_hint_of_other_lens(fix, lens, stars)
    if fix.reason is Reason.VERTICAL_REQUIRED:
        by_tags = "" if tags.up is None else ", or --attitude exif, by the accelerometer in the image's tags"
        fix = replace(fix, message=VERTICAL_WANTED + by_tags)
    limit = field_limit(lens.camera, arguments.solver)
    found = Answer(
        fix=replace(fix, solver=arguments.solver),
        detections=detections,
        camera=lens.camera,
        camera_from=lens.described,
        utc=moment.utc,
        attitude=attitude,
        R_cam=attitude_of(fix, moment.utc, arguments.dut1_s, attitude),
        assumed=(*lens.assumed, *moment.assumed, *_of_attitude(arguments.attitude, attitude, tags)),
        warnings=(*lens.warnings, *((limit,) if limit else ()), *_of_doubt(fix, lens, arguments.calibrate)),
        time_ms=clock.time_ms,
        sigmas=sigmas,
    )
    return _finished(found, image, arguments.plot, clock, started_s)


def _image_and_tags(path: str) -> tuple[NDArray[np.generic], PhotoTags]:
    """Read pixels and tags; a FITS file, whose header is read along with its pixels, is unpacked and decoded once."""
    if is_fits(path):
        found = read_fits(path)
        return found.pixels, tags_of_fits(found)
    return read_image(path), read_tags(path)


def _finished(found: Answer, image: NDArray[np.generic], plot: str | None, clock: _Clock, started_s: float) -> Answer:
    """Draw the answer, if that is wanted, and end its times, which the answer shares with the clock."""
    if plot is not None:
        from celnav.command.plot import draw

        with clock.stage("drawing"):
            draw(found, image, plot)
    clock.time_ms["total"] = 1000 * (time.perf_counter() - started_s)
    return found


def _with_hint_of_a_mirror(
    fix: Fix,
    detections: Detections,
    camera: Camera,
    utc: str,
    time_limit_s: float | None,
    dut1_s: float | None = None,
) -> Fix:
    """Add a hint to the message if the mirror image of the picture can be identified.

    Parameters
    ----------
    fix : Fix
        Any answer; those with identified stars are returned unchanged.
    detections : Detections
        Detections from an image, with its shape.
    camera : Camera
        The camera.
    utc : str
        Middle of the exposure.
    time_limit_s : float or None
        Time limit for the search of the mirror image.
    dut1_s : float or None
        UT1-UTC in seconds; None takes it from the IERS table.
    """
    if fix.reason not in NAMES_NO_STAR or detections.shape is None or len(detections) < FEWEST_TO_MIRROR:
        return fix
    last = detections.shape[0] - 1
    turned = replace(
        detections,
        uv=np.column_stack((detections.uv[:, 0], last - detections.uv[:, 1])),
        streak_px=None if detections.streak_px is None else detections.streak_px * [1, -1],
    )
    # Solve without a vertical, since stars can be identified whatever the attitude of the mirrored camera.
    try:
        mirrored = replace(camera, cy_px=last - camera.cy_px)
        named = solve(turned, mirrored, utc, None, dut1_s=dut1_s, time_limit_s=time_limit_s)
    except CelnavError:  # a hint that cannot be had must not replace the refusal
        return fix
    return replace(fix, message=f"{fix.message}; {MIRRORED}") if named.reason is Reason.VERTICAL_REQUIRED else fix


def _with_hint_of_other_lens(fix: Fix, lens: _Lens, detections: Detections) -> Fix:
    """Add a remedy to the message if no star can be identified with the camera that was told.

    A picture that was cropped, or taken with digital zoom, keeps the tags of the whole sensor.
    """
    if fix.reason not in NAMES_NO_STAR or len(detections) < FEWEST_TO_MIRROR or not (lens.of_tags or lens.calibrated):
        return fix
    if MIRRORED in fix.message:  # found with this very focal length
        return fix
    doubt = (
        "if the picture was cropped or zoomed, that focal length is not its own"
        if lens.of_tags
        else "if the camera's field or lens is known only roughly"
    )
    remedy = "give --camera unknown, which finds field and lens from the stars"
    return replace(fix, message=f"{fix.message}; {doubt}: {remedy}")


def _near(text: str | None, solver: str) -> LastKnown | None:
    """Read the option ``--near``."""
    if text is None:
        return None
    if solver != "skybench":
        raise ConfigError(f"--near: solver {solver} has no use for a last known position; skybench has")
    try:
        lat_deg, lon_deg, radius_km = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(
            f"--near {shown(text)} must be latitude, longitude (deg) and radius (km), such as 48.2,16.4,50"
        ) from None
    try:
        return LastKnown(lat_deg, lon_deg, radius_km)
    except ConfigError as error:
        raise ConfigError(f"--near {shown(text)}: {str(error).removeprefix('LastKnown: ')}") from None


def _nothing_told(arguments: argparse.Namespace, tags: PhotoTags) -> bool:
    """Return whether field and lens are to be found from the stars: on request, or if neither tags nor options give them."""
    if arguments.camera is not None:
        return bool(arguments.camera == UNKNOWN)
    told = arguments.focal_length_mm, arguments.sensor_width_mm, tags.focal_length_mm, tags.focal_length_35mm
    return all(value is None for value in told)


def _found_lens(found: FoundCamera) -> tuple[_Lens, Detections]:
    """Return the camera found from the stars, as an uncalibrated one, and the detections that it was found from."""
    assumed = (
        f"nothing of the camera: field and lens are found from {found.stars} stars ({found.scatter_px:.2f} px), as far out "
        "as they stand",
    )
    return _Lens(found.camera, "found from the stars", False, assumed), found.detections


def _lens(arguments: argparse.Namespace, tags: PhotoTags) -> _Lens:
    """Read the camera from its file, or derive it from the image's tags and the options."""
    if arguments.camera is None:
        photo = photo_camera(tags, arguments.focal_length_mm, arguments.sensor_width_mm)
        options = arguments.focal_length_mm is not None or arguments.sensor_width_mm is not None
        described = "from the options" if options else "from the image's EXIF tags"
        return _Lens(photo.camera, described, False, photo.assumed, photo.warnings, of_tags=True)
    if arguments.focal_length_mm is not None or arguments.sensor_width_mm is not None:
        raise CameraError("--focal-length-mm and --sensor-width-mm go without --camera, which says both")
    file = read_camera_file(arguments.camera, (tags.width, tags.height))
    return _Lens(file.camera, f"{file.kind}, {arguments.camera}", True, file.assumed)


def _of_doubt(fix: Fix, lens: _Lens, calibrate: Mode | None) -> tuple[str, ...]:
    """Say that the stars rule out the camera's lens, or that they scatter widely about one that is to be trusted."""
    doubt_deg = fix.details.get("lens_doubt_deg")
    if doubt_deg is not None and lens.of_tags:
        return (
            f"the stars rule out a pinhole, so the vertical is doubted by {doubt_deg:.1f} deg: give --camera unknown, which "
            "finds field and lens from the stars, or calibrate the camera (celnav calibrate)",
        )
    if doubt_deg is not None:
        return (
            f"the stars rule out the camera's lens, so the vertical is doubted by {doubt_deg:.1f} deg: calibrate the camera "
            "(celnav calibrate), or state how far its axis may be off (--sigma centre=30)",
        )
    if calibrate == "none" and fix.ok and fix.residual_rms_px > WIDE_SCATTER_PX:
        return (
            f"the stars scatter by {fix.residual_rms_px:.1f} px about the camera's lens, which --calibrate none trusts; if "
            "it does not hold, the position is off by more than is stated",
        )
    return ()


def _mode(arguments: argparse.Namespace, lens: _Lens, fitted: bool) -> Mode | None:
    """Return what the solver leaves free of the camera: nothing if it was fitted to the same stars; None for other solvers.

    With a vertical, refraction is removed from the stars, so the fitted lens, which had absorbed it, must be free to change.
    """
    if arguments.solver == "skybench":
        return arguments.calibrate or ("auto" if lens.calibrated else "none" if fitted else "full")
    if arguments.calibrate is not None:
        raise ConfigError(f"--calibrate: solver {arguments.solver} fits no camera; skybench does")
    return None


def perhaps_decentred(camera: Camera) -> Camera:
    """The camera with the decentring that a lens may have which nobody calibrated; no single frame tells it from a tilt."""
    variance = UNCALIBRATED_DECENTRING**2
    return replace(camera, uncertainty=LensUncertainty(("p1", "p2"), ((variance, 0.0), (0.0, variance))))


def _solver(arguments: argparse.Namespace, lens: _Lens, mode: Mode | None) -> str | Solver:
    """Return the solver, which leaves free what is unknown of the camera."""
    if mode is None:
        return str(arguments.solver)
    if lens.calibrated or mode != "full":
        return SkybenchSolver(SkybenchConfig(calibrate=mode))
    priors = CameraPriors(UNCALIBRATED_FOCAL, UNCALIBRATED_CENTRE * lens.camera.width, UNCALIBRATED_DISTORTION)
    return SkybenchSolver(SkybenchConfig(calibrate="full", priors=priors))


def _of_attitude(text: str, attitude: Attitude | None, tags: PhotoTags) -> list[str]:
    """Describe the assumptions about the attitude."""
    sentences = []
    if attitude is not None and is_of_gravity(text):
        sentences.append(
            f"the vertical is that of the telephone's accelerometer (EXIF maker note), to {attitude.tilt_deg:g} deg: a "
            f"position to some {111 * attitude.tilt_deg:.0f} km"
        )
    if attitude is not None and "altitude" in text and "=" in text and "roll" not in text:
        sentences.append("no roll given: the top of the image is towards the zenith")
    if attitude is not None and tags.orientation != 1:
        shown = {3: "half a turn", 6: "a quarter turn clockwise", 8: "a quarter turn counterclockwise"}
        turn = shown.get(tags.orientation, "mirrored")
        sentences.append(
            f"pixels, and so the attitude's roll, are those of the image as stored; programs show it {turn} from there "
            f"(EXIF orientation {tags.orientation})"
        )
    return sentences
