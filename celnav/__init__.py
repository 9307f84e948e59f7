"""Determine latitude and longitude from one image of the night sky.

Examples
--------
>>> import celnav
>>> camera = celnav.Camera.pinhole(width=1080, height=720, hfov_deg=120)
>>> detections = celnav.detect(image)
>>> fix = celnav.solve(detections, camera, utc="2020-01-01T00:00:00Z", attitude=R_cam)
"""

from typing import TYPE_CHECKING, Any

from celnav import errors
from celnav.attitude import Attitude
from celnav.camera import Camera
from celnav.command.camera_file import CameraFile, read_camera_file
from celnav.command.pointing import Pointing
from celnav.detecting.flood_fill import FloodFillConfig
from celnav.detection import FAINT_STARS, DetectionConfig, detect
from celnav.detections import Detections
from celnav.errors import CelnavError
from celnav.fix import Calibration, Estimate, Fix, Reason
from celnav.matching import THESIS_ADAPTIVE, THESIS_BASELINE, DdrConfig
from celnav.matching.history import History
from celnav.position import PositionConfig, Weather, fix_position, usual_weather
from celnav.problem import LastKnown, ToldSigmas
from celnav.reading.image_file import read_image
from celnav.sequences.track import Track, TrackConfig, TrackPoint
from celnav.skybench_config import SkybenchConfig
from celnav.skybench_solver import SkybenchSolver
from celnav.solver import SOLVERS, ddr_solver, solve, solvers

if TYPE_CHECKING:
    from celnav.calibrating.calibrate import calibrate
    from celnav.calibrating.calibration import CameraCalibration
    from celnav.calibrating.frames import CalibrationFrame
    from celnav.calibrating.lens_form import LensForm
    from celnav.calibrating.sky_mask import sky_mask
    from celnav.sequences.cameras import CamerasFix, CameraView, solve_cameras
    from celnav.sequences.night import Night, NightFix
    from celnav.unknown_camera import FoundCamera, find_camera

__all__ = [
    "FAINT_STARS",
    "SOLVERS",
    "THESIS_ADAPTIVE",
    "THESIS_BASELINE",
    "Attitude",
    "Calibration",
    "CalibrationFrame",
    "Camera",
    "CameraCalibration",
    "CameraFile",
    "CameraView",
    "CamerasFix",
    "CelnavError",
    "DdrConfig",
    "DetectionConfig",
    "Detections",
    "Estimate",
    "Fix",
    "FloodFillConfig",
    "FoundCamera",
    "History",
    "LastKnown",
    "LensForm",
    "Night",
    "NightFix",
    "Pointing",
    "PositionConfig",
    "Reason",
    "SkybenchConfig",
    "SkybenchSolver",
    "ToldSigmas",
    "Track",
    "TrackConfig",
    "TrackPoint",
    "Weather",
    "calibrate",
    "ddr_solver",
    "detect",
    "errors",
    "find_camera",
    "fix_position",
    "read_camera_file",
    "read_image",
    "sky_mask",
    "solve",
    "solve_cameras",
    "solvers",
    "usual_weather",
]


def __getattr__(name: str) -> Any:
    """Import calibration modules on first access, so that programs that only solve for a position start sooner."""
    if name == "calibrate":
        from celnav.calibrating.calibrate import calibrate

        return calibrate
    if name == "CameraCalibration":
        from celnav.calibrating.calibration import CameraCalibration

        return CameraCalibration
    if name in ("FoundCamera", "find_camera"):
        from celnav import unknown_camera

        return getattr(unknown_camera, name)
    if name == "CalibrationFrame":
        from celnav.calibrating.frames import CalibrationFrame

        return CalibrationFrame
    if name == "LensForm":
        from celnav.calibrating.lens_form import LensForm

        return LensForm
    if name == "sky_mask":
        from celnav.calibrating.sky_mask import sky_mask

        return sky_mask
    if name in ("Night", "NightFix"):
        from celnav.sequences import night

        return getattr(night, name)
    if name in ("CameraView", "CamerasFix", "solve_cameras"):
        from celnav.sequences import cameras

        return getattr(cameras, name)
    raise AttributeError(f"module 'celnav' has no attribute {name!r}")
