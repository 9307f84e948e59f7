"""The two centroids of the truth: the geometric one, and the first moment of the light in an image without noise."""

import numpy as np
import pytest
from small_scenes import small_scenario

from benchmark.frames.dataset import TruthStars
from benchmark.judge.star_id import score_matches
from generator.frame.exposure.expected import render_expected
from generator.frame.object_table import object_table
from generator.frame.plan import plan_frame
from generator.frame.record import star_table

WIDTH, HEIGHT, REACH = 900, 620, 20
# The Gaussian keeps the pixel's own error away: of an undersampled star the moment of whole pixels goes with its phase.
COMA = {"diffraction": {"f_number": 2.8, "coma_waves": 0.5}, "gaussian_sigma_px": 0.4, "support_px": 14}
COLOUR = {"gaussian_sigma_px": 0.9, "lateral_chromatic_px": 3.0, "support_px": 14}
CAMERA = {
    "camera__width": WIDTH, "camera__height": HEIGHT, "camera__hfov_deg": 38.0, "camera__pixel_pitch_um": 2.9,
    "sky__bortle": None, "time__exposure_s": 4.0,
    "attitude": {"azimuth_deg": 150, "altitude_deg": 40, "roll_deg": 10},
}  # fmt: skip


def isolated_stars(psf, **overrides):
    """Rows of the star table without a neighbour or an edge in reach, and the image's first moments around them."""
    scenario = small_scenario(**(CAMERA | overrides), camera__psf=psf, stars={"limiting_magnitude": 5.0})
    plan = plan_frame(scenario, 0)
    expected = render_expected(plan)
    stars = star_table(plan, expected).to_pandas()
    place = stars[["light_u_px", "light_v_px"]].to_numpy()
    found = []
    for row, (u, v) in enumerate(place):
        column, line = round(u), round(v)
        if not (REACH <= column < WIDTH - REACH and REACH <= line < HEIGHT - REACH) or stars["electrons_e"][row] < 2000:
            continue
        others = np.abs(np.delete(place, row, axis=0) - (u, v)).max(axis=1)
        if others.min() < 2 * REACH:
            continue
        window = expected.electrons[line - REACH : line + REACH + 1, column - REACH : column + REACH + 1].astype(float)
        offset = np.arange(-REACH, REACH + 1)
        along_u, along_v = (window.sum(axis=axis) @ offset / window.sum() for axis in (0, 1))
        found.append((row, along_u + column, along_v + line))
    rows = np.array([entry[0] for entry in found])
    assert len(rows) >= 8
    return stars.iloc[rows], np.array([entry[1:] for entry in found]), plan, expected


def light(stars):
    return stars[["light_u_px", "light_v_px"]].to_numpy()


def geometric(stars):
    return stars[["centroid_u_px", "centroid_v_px"]].to_numpy()


@pytest.mark.parametrize(
    "psf",
    [
        pytest.param(COMA, marks=pytest.mark.journey),
        pytest.param(COLOUR, marks=pytest.mark.journey),
        COMA | {"lateral_chromatic_px": 2.0},
    ],
)
def test_the_light_s_centroid_is_the_image_s_first_moment(psf) -> None:
    """Within 0.02 px at rest, while the geometric centroid is off by 0.2 px and more."""
    stars, moment, _, _ = isolated_stars(psf)
    off = np.hypot(*(moment - geometric(stars)).T)
    assert off.max() > 0.2
    assert np.hypot(*(moment - light(stars)).T).max() < 0.02


@pytest.mark.journey
def test_trails_of_asymmetric_stars() -> None:
    """A camera that turns while stars trail through the field of coma: weighted along the trail, within 0.02 px."""
    stars, moment, _, _ = isolated_stars(COMA, motion={"rate_deg_s": [0.05, 0.1, 0.2]})
    trail = np.hypot(stars["end_u_px"] - stars["start_u_px"], stars["end_v_px"] - stars["start_v_px"])
    assert trail.median() > 8
    assert np.hypot(*(moment - geometric(stars)).T).max() > 0.2
    assert np.hypot(*(moment - light(stars)).T).max() < 0.02


def test_lateral_colour_moves_red_stars_outwards_and_blue_ones_inwards() -> None:
    """By a star's colour: of B-V 1.4 against 0 some 0.4 px at the corner for 3 px between 450 and 650 nm."""
    stars, _, plan, _ = isolated_stars(COLOUR, sensor={"colour": None})
    projection = plan.spec.camera.projection
    away = geometric(stars) - (projection.cx_px, projection.cy_px)
    distance = np.hypot(*away.T)
    outwards = np.einsum("ij,ij->i", light(stars) - geometric(stars), away) / distance
    per_corner = outwards / distance * plan.spec.camera.corner_px
    slope, _ = np.polyfit(stars["bv_mag"], per_corner, 1)
    assert slope > 0.2
    np.testing.assert_allclose(light(stars) - geometric(stars), outwards[:, None] * away / distance[:, None], atol=1e-9)


def test_a_symmetric_point_spread_has_one_centroid() -> None:
    scenario = small_scenario(**CAMERA, stars={"limiting_magnitude": 5.0}, motion={"rate_deg_s": [0.05, 0.1, 0.2]})
    plan = plan_frame(scenario, 0)
    stars = star_table(plan, render_expected(plan)).to_pandas()
    np.testing.assert_array_equal(light(stars), geometric(stars))


def test_objects_have_both() -> None:
    """A satellite through the field of coma: the light's centroid is the image's first moment."""
    trail = {
        "kind": "satellite", "v_mag": 0.0, "bv_mag": 0.6,
        "start": {"azimuth_deg": 158, "altitude_deg": 48}, "end": {"azimuth_deg": 160, "altitude_deg": 49},
    }  # fmt: skip
    scenario = small_scenario(
        **CAMERA,
        camera__psf=COMA,
        stars={"limiting_magnitude": -2.0, "planets": False},
        foreground={"trails": [trail]},
    )
    plan = plan_frame(scenario, 0)
    expected = render_expected(plan)
    row = object_table(plan, expected).to_pandas().iloc[0]
    image = expected.electrons.astype(float)
    moment = np.array([image.sum(axis=0) @ np.arange(WIDTH), image.sum(axis=1) @ np.arange(HEIGHT)]) / image.sum()
    assert np.hypot(*(moment - [row["light_u_px"], row["light_v_px"]])) < 0.02
    assert np.hypot(*(moment - [row["centroid_u_px"], row["centroid_v_px"]])) > 0.05


def test_matches_are_held_against_the_light() -> None:
    """A detection 3.5 px from the star's place but on its light is that star's."""
    truth = TruthStars(
        star_id=np.array([42]), uv=np.array([[10.0, 10.0]]), electrons_e=np.array([1e4]), snr=np.array([50.0]),
        light_uv=np.array([[13.4, 10.0]]),
    )  # fmt: skip
    match = np.array([[0, 42]])
    assert score_matches(np.array([[13.5, 10.0]]), match, truth).n_correct == 1
    assert score_matches(np.array([[8.0, 10.0]]), match, truth).n_correct == 0
