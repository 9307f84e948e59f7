"""Bloom and ghosts: light is moved, not made or lost; where it goes; and nothing at all unless asked for."""

import numpy as np
import pytest
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.plan import plan_frame
from generator.frame.scene import render_expected
from generator.optics.stray_light import with_stray_light
from generator.scenario.camera_spec import CameraSpec

LENS = {"width": 401, "height": 301, "f_px": 400.0, "aperture_mm": 4.0}
BLOOM = {"share": 0.05, "core_px": 2.0, "reach_px": 120}


def lens(**more) -> CameraSpec:
    return CameraSpec.model_validate(LENS | more)


def one_star(camera: CameraSpec, u: int, v: int) -> np.ndarray:
    """Frame of one star of 1e6 electrons in one pixel, in two channels."""
    points = np.zeros((camera.height, camera.width, 2), np.float32)
    points[v, u] = 1e6, 5e5
    return points


def test_light_is_conserved() -> None:
    """Wings and ghosts that lie inside the frame: to 1e-6, in each channel."""
    camera = lens(bloom=BLOOM, ghosts=[{"share": 0.01, "magnification": -0.5, "diameter_px": 30.0}])
    image = with_stray_light(one_star(camera, 190, 140), camera)
    np.testing.assert_allclose(image.astype(float).sum(axis=(0, 1)), [1e6, 5e5], rtol=1e-6)
    assert image.min() >= 0
    assert image[140, 190, 0] == pytest.approx(0.94e6 + image[140, 191, 0], rel=0.01)


@pytest.mark.parametrize("slope", [2.0, 3.0])
def test_wings_fall_with_their_slope(slope) -> None:
    """Between 20 and 100 px, far from the core, by the exponent asked for (King's 2 among them)."""
    camera = lens(bloom=BLOOM | {"slope": slope})
    image = with_stray_light(one_star(camera, 200, 150), camera)[:, :, 0].astype(float)
    radius = np.array([20, 40, 60, 80, 100])
    fitted = np.polyfit(np.log(radius), np.log(image[150, 200 + radius]), 1)
    assert -fitted[0] == pytest.approx(slope, abs=0.02)
    np.testing.assert_allclose(image[150 - radius, 200], image[150, 200 + radius], rtol=1e-4)
    assert image[150, 200 + 121] < 1e-6


@pytest.mark.parametrize("magnification", [-1.0, -0.4, 0.7])
def test_a_ghost_lies_where_the_law_puts_it(magnification) -> None:
    """Centroid, share and second moment (an even disk's is diameter^2 / 16 per axis), about an off-centre principal point."""
    ghost = {"share": 0.02, "magnification": magnification, "diameter_px": 24.0}
    camera = lens(cx_px=210.0, cy_px=140.0, ghosts=[ghost])
    image = with_stray_light(one_star(camera, 260, 165), camera)[:, :, 0].astype(float)
    image[165, 260] -= 0.98e6
    v, u = np.mgrid[0:301, 0:401]
    middle = [(image * axis).sum() / image.sum() for axis in (u, v)]
    assert image.sum() == pytest.approx(2e4, rel=1e-5)
    assert middle == pytest.approx([210 + magnification * 50, 140 + magnification * 25], abs=0.01)
    assert (image * (u - middle[0]) ** 2).sum() / image.sum() == pytest.approx(24.0**2 / 16, rel=0.02)


def test_rendered_stars_keep_their_light_and_lose_signal_to_noise() -> None:
    values = {"camera__width": 540, "camera__height": 360, "sky": None, "stars": {"limiting_magnitude": 2.5}}
    plain = render_expected(plan_frame(small_scenario(**values), 0))
    plan = plan_frame(small_scenario(**values, camera__bloom=BLOOM | {"reach_px": 60}), 0)
    veiled = render_expected(plan)
    assert np.array_equal(plain.star_electrons, veiled.star_electrons)
    # What leaves the frame is the wings of the stars near its edges.
    assert float(veiled.electrons.astype(float).sum()) == pytest.approx(
        float(plain.electrons.astype(float).sum()), rel=5e-3
    )
    assert plain.electrons.max() * 0.94 < veiled.electrons.max() < plain.electrons.max() * 0.97
    assert plan.spec.camera.direct_share == pytest.approx(0.95)


def test_the_diffuse_sky_is_left_alone() -> None:
    values = {"stars": {"limiting_magnitude": -2.0, "planets": False}}
    plain = render_expected(plan_frame(small_scenario(**values), 0))
    veiled = render_expected(plan_frame(small_scenario(**values, camera__bloom=BLOOM), 0))
    np.testing.assert_array_equal(plain.electrons, veiled.electrons)


def test_without_them_a_scenario_is_what_it_was() -> None:
    """Neither key is part of the hash unless it is given."""
    assert "bloom" not in lens().model_dump()
    assert "ghosts" not in lens().model_dump()
    assert "bloom" in lens(bloom=BLOOM).model_dump()
    assert small_scenario(camera__bloom=BLOOM).sha256 != small_scenario().sha256


@pytest.mark.parametrize(
    ("values", "fragments"),
    [
        ({"camera__bloom": {"share": 0.7}}, ["camera.bloom.share", "<= 0.5"]),
        ({"camera__ghosts": [{"share": 0.01, "magnification": 4, "diameter_px": 5}]}, ["camera.ghosts.0", "twice"]),
        (
            {
                "camera__bloom": {"share": 0.5},
                "camera__ghosts": [{"share": 0.1, "magnification": place, "diameter_px": 5} for place in (1, 2)],
            },
            ["camera", "at most 0.6 together"],
        ),
    ],
)
def test_impossible_ones_are_refused(values, fragments) -> None:
    with pytest.raises(ScenarioError) as caught:
        small_scenario(**values)
    for fragment in fragments:
        assert fragment in str(caught.value)
