"""Images of noise alone: their faint detections, which a solver gets where no star stands out, lead to no fix."""

import numpy as np
import pytest

import celnav

CAMERA = celnav.Camera("pinhole", width=640, height=480, f_px=554.3, cx_px=319.5, cy_px=239.5)
UP = np.array([0.1, -0.3, np.sqrt(0.9)])
FRAMES = {"attitude": 300, "vertical": 100, "nothing": 30}


@pytest.mark.slow
@pytest.mark.parametrize("told", list(FRAMES))
def test_no_image_of_noise_is_a_fix(told):
    """The identification's bound is 1e-6 a frame: one fix among some hundred frames has a chance of one in two thousand."""
    east = np.cross([0, 1, 0], UP) / np.linalg.norm(np.cross([0, 1, 0], UP))
    attitude = {
        "attitude": celnav.Attitude.exact(np.column_stack((east, np.cross(UP, east), UP))),
        "vertical": celnav.Attitude.up(UP, tilt_deg=0.1),
        "nothing": None,
    }[told]
    config = celnav.DetectionConfig(faint_stars=celnav.FAINT_STARS)
    for seed in range(FRAMES[told]):
        rng = np.random.default_rng([71, seed])
        image = np.rint(1000 + rng.normal(0, 20, (CAMERA.height, CAMERA.width))).astype(np.uint16)
        found = celnav.detect(image, config=config)
        assert len(found) == celnav.FAINT_STARS
        fix = celnav.solve(found, CAMERA, f"2021-{1 + seed % 12:02}-05T{seed % 24:02}:30:00Z", attitude)
        assert not len(fix.matches), fix
