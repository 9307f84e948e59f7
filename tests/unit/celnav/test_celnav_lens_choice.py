"""Which lens forms a calibration may choose: those whose covariance says what is known."""

from __future__ import annotations

import numpy as np
import pytest

from celnav.calibrating.bundle import Bundle, Observations, adjust
from celnav.calibrating.calibrate import calibrate
from celnav.calibrating.frames import CalibrationFrame
from celnav.calibrating.lens_form import LensForm
from celnav.calibrating.model_choice import choose_form, knows_its_errors, started
from celnav.camera import Camera
from celnav.detections import Detections
from celnav.errors import CalibrationError, ConfigError

SIZE = (1280, 720)
LENS = LensForm("kannala_brandt", 1)


def seen_by(lens, count):
    """Stars anywhere in the frame, and the bundle that they were made with."""
    rng = np.random.default_rng(3)
    camera = Camera("kannala_brandt", *SIZE, 895.0, 895.0, 640.0, 360.0, k=(-0.13,))
    uv = rng.uniform(5, np.array(SIZE) - 5, (count, 2))
    dirs = camera.to_rays(uv)
    rows, zero = np.arange(count), np.zeros(count, dtype=np.intp)
    noisy = uv + rng.normal(0, 0.14, uv.shape)
    seen = Observations(noisy, dirs, np.full(count, 0.14), zero, rows, rows, np.zeros(count))
    return Bundle(lens, SIZE, lens.values_of(camera), np.eye(3)[None]), seen, zero


@pytest.mark.parametrize(
    ("form", "count", "known"),
    [
        (LENS, 30, True),
        (LensForm("kannala_brandt", 4), 30, True),
        (LensForm("brown_conrady", 3), 30, True),
        (LensForm("brown_conrady", 6), 30, False),
        (LensForm("kannala_brandt", 1, decentring=True, prism=True, tilt=True), 30, False),
        (LensForm("kannala_brandt", 1, decentring=True, tilt=True), 3000, True),
    ],
)
def test_what_few_stars_cannot_tell_is_seen(form, count, known):
    """Rational terms, and decentring beside prism and tilt, follow few stars along curves that no covariance describes."""
    bundle, seen, group = seen_by(LENS, count)
    fitted = adjust(started(bundle, form), seen, group, robust=False)
    assert knows_its_errors(fitted, seen, group) == known


def test_the_chosen_form_knows_its_errors():
    bundle, seen, group = seen_by(LENS, 30)
    form, judged = choose_form(bundle, seen, group)
    fitted = adjust(started(bundle, form), seen, group, robust=False)
    assert knows_its_errors(fitted, seen, group)
    assert fitted.cov is not None
    assert np.sqrt(np.diag(fitted.cov))[form.names.index("k1")] < 0.1
    assert len(judged) > 30


@pytest.mark.parametrize(("models", "opencv_only"), [(("pinhole",), False), (("pinhole", "equisolid"), True)])
def test_models_that_cannot_show_the_field_are_named(models, opencv_only):
    """Stars 86 deg from the axis, and no law left that shows them."""
    rng = np.random.default_rng(5)
    camera = Camera("equidistant", *SIZE, 420.0)
    uv = np.array([640.0, 360.0]) + rng.uniform(-0.5, 0.5, (60, 2)) * [1230, 100]
    uv[0] = 10.0, 360.0
    rows, zero = np.arange(60), np.zeros(60, dtype=np.intp)
    seen = Observations(uv, camera.to_rays(uv), np.full(60, 0.1), zero, rows, rows, np.zeros(60))
    lens = LensForm("equidistant")
    with pytest.raises(CalibrationError, match=f"{', '.join(models)}.*--models.*86 deg"):
        choose_form(
            Bundle(lens, SIZE, lens.values_of(camera), np.eye(3)[None]), seen, zero, models, opencv_only=opencv_only
        )


def test_models_that_opencv_cannot_hold_are_refused_before_the_search():
    frame = CalibrationFrame(Detections(np.empty((0, 2)), np.empty(0), SIZE[::-1], None), "2021-08-05T05:30:00Z", SIZE)
    with pytest.raises(ConfigError, match=r"equisolid, stereographic \(--models\).*kannala_brandt.*--opencv-only"):
        calibrate([frame], 1.0, 2.0, models=("equisolid", "stereographic"), opencv_only=True)
    with pytest.raises(ConfigError, match="OpenCV cannot hold"):
        calibrate([frame], 1.0, 2.0, form=LensForm("equisolid"), opencv_only=True)
