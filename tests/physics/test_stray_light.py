"""Wings, veiling glare and ghosts: light is moved, not made; it goes where the published laws put it, from anywhere."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from physics.moon_alone import MOON, rendered
from scipy import integrate
from small_scenes import small_scenario

from generator import plugins
from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.optics.light_cells import cells_outside
from generator.optics.stray_light import PointSources, Surround, cell_grid, ghosts, stray_light
from generator.optics.wings import encircled, profile
from generator.scenario.camera_spec import BloomSpec, CameraSpec

LENS = {"width": 401, "height": 301, "f_px": 400.0, "aperture_mm": 4.0, "bloom": {"share": 0}, "veiling_glare": 0}
BLOOM = {"share": 0.05, "core_px": 4.0, "slope": 2.4, "reach_px": 120}


def lens(**more: Any) -> CameraSpec:
    return CameraSpec.model_validate(LENS | more)


def of_points(camera: CameraSpec, u: float, v: float, electrons: tuple[float, ...] = (1e6, 5e5)) -> NDArray[np.float64]:
    """Light astray of one point, in two channels."""
    grid = cell_grid(camera, colour=False)
    dark = Surround(np.zeros((len(cells_outside(grid)[0]), 2)), np.zeros(2), np.zeros((1, 2)))
    point = [PointSources(np.array([u]), np.array([v]), np.array([electrons]))]
    nothing = plugins.start().TensorXf(np.zeros((camera.height, camera.width, 2), np.float32))
    planes = stray_light(nothing, point, dark, grid, camera)
    if camera.all_ghosts:
        more = ghosts(nothing, point, dark, grid, camera)
        planes = [light + ghost for light, ghost in zip(planes, more, strict=True)]
    light = np.stack([np.array(plane, dtype=float) for plane in planes], axis=1)
    return light.reshape(camera.height, camera.width, 2)


def test_light_is_conserved() -> None:
    """Wings and ghosts that lie inside the frame: to 1e-5, in each channel."""
    camera = lens(bloom=BLOOM, ghosts=[{"share": 0.01, "magnification": -0.5, "diameter_px": 30.0}])
    image = of_points(camera, 190, 140)
    np.testing.assert_allclose(image.sum(axis=(0, 1)), [0.06e6, 0.03e6], rtol=1e-5)
    assert image.min() >= 0
    assert camera.direct_share == pytest.approx(0.94)


@pytest.mark.parametrize("core", [2.0, 4.0, 8.0])
@pytest.mark.parametrize("slope", [2.0, 2.4, 3.0])
def test_encircled_light_of_the_wings(core, slope) -> None:
    """Within 1 % of all their light at each radius, wherever the point falls on the cells; the law by adaptive quadrature."""
    bloom = BloomSpec.model_validate(BLOOM | {"core_px": core, "slope": slope})

    def law(r: float) -> float:
        return r * ((1 + (r / core) ** 2) ** (-slope / 2) - (1 + (bloom.reach_px / core) ** 2) ** (-slope / 2))

    whole = integrate.quad(law, 0, bloom.reach_px, limit=200)[0]
    for u, v in ((200.0, 150.0), (203.4, 154.8)):
        image = of_points(lens(bloom=bloom.model_dump()), u, v)[:, :, 0] / 0.05e6
        radius = np.hypot(np.arange(401) - u, (np.arange(301) - v)[:, None])
        for within in (6, 10, 20, 40, 80, 110):
            share = integrate.quad(law, 0, within, limit=200)[0] / whole
            assert image[radius <= within].sum() == pytest.approx(share, abs=0.01)
            assert encircled(bloom, within) == pytest.approx(share, rel=1e-6)


def test_wings_narrower_than_a_pixel_hold_their_light() -> None:
    """Cells blur the narrowest part of them by more than its own width."""
    bloom = BloomSpec.model_validate(BLOOM | {"core_px": 0.5, "slope": 2.4})
    image = of_points(lens(bloom=bloom.model_dump()), 200.0, 150.0)[:, :, 0] / 0.05e6
    radius = np.hypot(np.arange(401) - 200.0, (np.arange(301) - 150.0)[:, None])
    assert image.sum() == pytest.approx(1, abs=1e-3)
    for within in (10, 20, 40, 80):
        assert image[radius <= within].sum() == pytest.approx(encircled(bloom, within), abs=0.02)


@pytest.mark.parametrize("slope", [2.0, 3.0])
def test_wings_fall_with_their_slope(slope) -> None:
    """Between 20 and 100 px, far from the core, by the exponent asked for (King's 2 among them), and end at their reach."""
    camera = lens(bloom=BLOOM | {"slope": slope, "reach_px": 1500})
    image = of_points(camera, 200, 150)[:, :, 0]
    radius = np.array([20, 40, 60, 80, 100])
    there = image[150, 200 + radius] + image[150, 200 - radius] + image[150 + radius, 200] + image[150 - radius, 200]
    fitted = np.polyfit(np.log(radius), np.log(there), 1)
    assert -fitted[0] == pytest.approx(slope, abs=0.07)
    np.testing.assert_allclose(there, 4 * 0.05e6 * profile(camera.bloom, radius), rtol=0.06)
    short = of_points(lens(bloom=BLOOM | {"slope": slope}), 200, 150)[:, :, 0]
    assert short[150, 200 + 140] < 1e-3 * short[150, 200 + 60]


def test_stars_in_rendered_frames_have_the_wings() -> None:
    """Sirius in a frame: the light beyond 3.5, 10 and 40 px is that of the law, to 0.5 % of the star's light."""
    values = {
        "time": {"utc_start": "2020-01-15T23:00:00Z", "exposure_s": 0.1},
        "attitude": {"azimuth_deg": 188, "altitude_deg": 20},
        "sky": {"components": []},
        "stars": {"limiting_magnitude": -1.3, "planets": False},
        "camera__hfov_deg": 40,
    }
    bloom = {"share": 0.33, "core_px": 4.0, "slope": 2.4, "reach_px": 60}
    frame = rendered(**values, camera__bloom=bloom)
    star = int(np.nanargmax(frame.star_electrons * (frame.fraction_in_frame > 0.5)))
    u, v = frame.u_px[star], frame.v_px[star]
    assert 62 < u < 207
    assert 62 < v < 117
    radius = np.hypot(np.arange(270) - u, (np.arange(180) - v)[:, None])
    total = frame.star_electrons[star]
    law = BloomSpec.model_validate(bloom)
    assert float(frame.electrons.astype(float).sum()) == pytest.approx(total, rel=2e-3)
    for beyond in (3.5, 10, 40):
        outside = float(frame.electrons[radius > beyond].astype(float).sum())
        assert outside / total == pytest.approx(0.33 * (1 - encircled(law, beyond)), abs=0.005)


def test_an_even_field_stays_as_it_is() -> None:
    """An even sky in a narrow field, where nothing varies: wings give back what they take, at the edges and corners too."""
    values = {
        "attitude": {"azimuth_deg": 0, "altitude_deg": 90},
        "camera__hfov_deg": 0.2,
        "sky": {"zenith_mag_arcsec2": 20.0, "components": ["airglow"]},
        "stars": {"limiting_magnitude": -2.0, "planets": False},
    }
    plain = rendered(**values)
    for size in ({}, {"camera__width": 267, "camera__height": 179}, {"sensor__colour": {"pattern": "RGGB"}}):
        plain, veiled = rendered(**values, **size), rendered(**values, **size, camera__bloom=BLOOM)
        np.testing.assert_allclose(veiled.electrons, plain.electrons, rtol=2e-4)
        np.testing.assert_array_equal(veiled.electrons, veiled.sky_electrons)


def test_what_a_moon_outside_the_frame_scatters_into_it() -> None:
    """Against the law, integrated over the Moon's disk by hand: its place from the truth, its light from a frame with it."""
    bloom = {"share": 0.2, "core_px": 4.0, "slope": 2.4, "reach_px": 400}
    inside = rendered(**MOON, camera__hfov_deg=40, attitude={"azimuth_deg": 170, "altitude_deg": 50})
    assert inside.moon.fraction_in_frame[0] > 0.99
    values = MOON | {"camera__hfov_deg": 40, "attitude": {"azimuth_deg": 200, "altitude_deg": 50}}
    without, frame = rendered(**values), rendered(**values, camera__bloom=bloom)
    u, v = float(frame.moon.u_px[0]), float(frame.moon.v_px[0])
    assert u < -20
    assert without.electrons.max() == 0
    law = BloomSpec.model_validate(bloom)
    rows, columns = np.arange(20, 170, 30), np.array([2, 20, 60, 120])
    distance = np.hypot(columns - u, (rows - v)[:, None])
    wanted = 0.2 * float(frame.moon.electrons[0]) * profile(law, distance)
    np.testing.assert_allclose(frame.electrons[np.ix_(rows, columns)], wanted, rtol=0.05)


@pytest.mark.parametrize("radius_px", [12, 40])
def test_the_glare_index_of_iso_9358(radius_px) -> None:
    """A black spot in an evenly lit hemisphere: its image's middle over the field's, the wings' part by quadrature."""
    bloom = {"share": 0.2, "core_px": 4.0, "slope": 2.4, "reach_px": 300}
    camera = lens(bloom=bloom, veiling_glare=0.015)
    grid = cell_grid(camera, colour=False)
    spot = np.hypot(np.arange(401) - 200, (np.arange(301) - 150)[:, None]) <= radius_px
    field = np.where(spot, 0, 1000).astype(np.float32)[:, :, None]
    even = Surround(np.full((len(cells_outside(grid)[0]), 1), 1000.0), np.array([1000.0]), np.zeros((1, 1)))
    (wide,) = stray_light(plugins.start().TensorXf(field), [], even, grid, camera)
    image = camera.direct_share * field + np.array(wide).reshape(field.shape)

    def law(r: float) -> float:
        return r * ((1 + (r / 4) ** 2) ** -1.2 - (1 + 75**2) ** -1.2)

    beyond = integrate.quad(law, radius_px, 300, limit=200)[0] / integrate.quad(law, 0, 300, limit=200)[0]
    index = image[150, 200, 0] / image[20, 30, 0]
    assert image[20, 30, 0] == pytest.approx(1000, rel=0.02)
    assert index == pytest.approx((0.015 + 0.2 * beyond) / (image[20, 30, 0] / 1000), rel=0.03)


@pytest.mark.parametrize("pupil", ["cosine", "constant"])
def test_veiling_glare_is_of_the_mean_light_before_the_lens(pupil) -> None:
    """Of a sky that brightens towards the horizon: its mean over the hemisphere as the pupil sees it, by quadrature."""
    values = {
        "attitude": {"azimuth_deg": 0, "altitude_deg": 90},
        "camera__hfov_deg": 30,
        "camera__pupil": pupil,
        "sky": {"components": ["airglow"]},
        "atmosphere": {"extinction": False, "refraction": False},
        "stars": {"limiting_magnitude": -2.0, "planets": False},
    }
    even, glare = rendered(**values), rendered(**values, camera__veiling_glare=0.03)
    added = glare.electrons - 0.97 * even.electrons
    assert np.ptp(added) < 1e-3 * added.mean()
    (table,) = frame_layers(plan_frame(small_scenario(**values), 0)).values()
    altitude = np.linspace(0, 90, 2001)
    radiance = table.signal(np.ones((1, table.spectra.shape[1])), altitude, np.zeros_like(altitude))[0]
    sine = np.sin(np.radians(altitude))
    weight = 2 * sine if pupil == "cosine" else np.ones_like(sine)
    mean = integrate.trapezoid(radiance * weight, sine) / radiance[-1]
    middle = float(even.electrons[88:92, 133:137].mean())
    assert added.mean() / middle == pytest.approx(0.03 * mean, rel=0.01)


def test_haze_looks_like_an_even_field_of_a_share_of_the_mean_light() -> None:
    """Within the image circle and with the lens' vignetting, the pixels' solid angles by the law of the projection; no light
    outside the circle. Its level is that of the veiling glare of the same share, whose mean is checked by quadrature."""
    values = {
        "attitude": {"azimuth_deg": 0, "altitude_deg": 90},
        "camera__model": "equidistant",
        "camera__hfov_deg": 150,
        "camera__image_circle_px": 110.0,
        "camera__vignetting": [-0.5],
        "sky": {"components": ["airglow"]},
        "stars": {"limiting_magnitude": -2.0, "planets": False},
    }
    clean, haze, glare = (
        rendered(**values, **more) for more in ({}, {"camera__haze": 0.1}, {"camera__veiling_glare": 0.1})
    )
    added = np.squeeze(haze.electrons - 0.9 * clean.electrons)
    even = float(np.mean(glare.electrons - 0.9 * clean.electrons))
    camera = plan_frame(small_scenario(**values), 0).spec.camera
    middle = camera.projection
    radius = np.hypot(np.arange(camera.width) - middle.cx_px, (np.arange(camera.height) - middle.cy_px)[:, None])
    angle = np.maximum(radius / middle.f_px, 1e-9)
    field = np.sin(angle) / angle * (1 - 0.5 * (radius / camera.corner_px) ** 2)
    inside = radius < 109
    np.testing.assert_allclose(added[inside], even * field[inside], rtol=2e-3)
    assert np.abs(added[radius > 111]).max() < 1e-6 * even
    # Light is moved: what goes into the haze is taken from images.
    assert camera.direct_share - small_scenario(**values, camera__haze=0.1).frame(
        0
    ).camera.direct_share == pytest.approx(0.1)


def test_haze_is_of_the_moons_light_too() -> None:
    """A Moon outside the frame: as much haze on the axis as veiling glare of the same share."""
    even, glare, haze = (
        rendered(**MOON, **more) for more in ({}, {"camera__veiling_glare": 0.02}, {"camera__haze": 0.02})
    )
    middle = np.s_[88:92, 133:137]
    assert float(haze.electrons[middle].mean()) > 0
    assert float((haze.electrons - 0.98 * even.electrons)[middle].mean()) == pytest.approx(
        float((glare.electrons - 0.98 * even.electrons)[middle].mean()), rel=1e-3
    )


@pytest.mark.parametrize("magnification", [-1.0, -0.4, 0.7])
def test_a_ghost_lies_where_the_law_puts_it(magnification) -> None:
    """Centroid, share and second moment (an even disk's is diameter^2 / 16 per axis), about an off-centre principal point."""
    ghost = {"share": 0.02, "magnification": magnification, "diameter_px": 24.0}
    camera = lens(cx_px=210.0, cy_px=140.0, ghosts=[ghost])
    image = of_points(camera, 260, 165)[:, :, 0]
    v, u = np.mgrid[0:301, 0:401]
    middle = [(image * axis).sum() / image.sum() for axis in (u, v)]
    assert image.sum() == pytest.approx(2e4, rel=1e-5)
    assert middle == pytest.approx([210 + magnification * 50, 140 + magnification * 25], abs=0.02)
    assert (image * (u - middle[0]) ** 2).sum() / image.sum() == pytest.approx(24.0**2 / 16, rel=0.03)


def test_a_moon_outside_the_frame_has_its_ghost_inside() -> None:
    ghost = {"share": 0.01, "magnification": -0.3, "diameter_px": 20.0}
    values = MOON | {"camera__hfov_deg": 40, "attitude": {"azimuth_deg": 200, "altitude_deg": 50}}
    plain, frame = rendered(**values), rendered(**values, camera__ghosts=[ghost])
    added = frame.electrons - 0.99 * plain.electrons
    v, u = np.unravel_index(np.argmax(added), added.shape)
    assert np.hypot(u - 134.5 + 0.3 * (frame.moon.u_px[0] - 134.5), v - 89.5 + 0.3 * (frame.moon.v_px[0] - 89.5)) < 10
    disk = 0.01 * frame.moon.electrons[0] / (math.pi * 10**2)
    assert added.max() == pytest.approx(disk, rel=0.1)


def test_wings_cost_signal_to_noise_and_no_light() -> None:
    values = {
        "camera__width": 540,
        "camera__height": 360,
        "sky": {"components": []},
        "stars": {"limiting_magnitude": 2.5},
    }
    plain = rendered(**values)
    veiled = rendered(**values, camera__bloom=BLOOM | {"reach_px": 60})
    assert np.array_equal(plain.star_electrons, veiled.star_electrons)
    # What leaves the frame is the wings of the stars near its edges.
    assert float(veiled.electrons.astype(float).sum()) == pytest.approx(
        float(plain.electrons.astype(float).sum()), rel=5e-3
    )
    assert plain.electrons.max() * 0.94 < veiled.electrons.max() < plain.electrons.max() * 0.97
    assert veiled.sky_electrons.min() >= 0


def test_layers_add_up_to_the_frame() -> None:
    """With wings, glare, a ghost, the Moon: each layer with the light that the lens scatters of it."""
    values = MOON | {"camera__hfov_deg": 60, "attitude": {"azimuth_deg": 170, "altitude_deg": 50}}
    values |= {"sky": {"bortle": 4}, "camera__bloom": BLOOM, "camera__veiling_glare": 0.02}
    values |= {"camera__ghosts": [{"share": 0.001, "magnification": -0.5, "diameter_px": 30}]}
    whole = render_expected(plan_frame(small_scenario(**values), 0), layers=True)
    total = np.sum([layer.astype(float) for layer in whole.layers.values()], axis=0)
    np.testing.assert_allclose(total, whole.electrons, rtol=2e-3)


def test_a_filter_array_s_pixels_do_not_depend_on_the_channels_written() -> None:
    """Of a Moon beside the frame and wings at the filter array's scale: the same electrons to the bit."""
    values = MOON | {"sky": {"bortle": 4}, "stars": {}, "camera__bloom": BLOOM, "sensor__colour": {"pattern": "RGGB"}}
    plan = plan_frame(small_scenario(**values), 0)
    np.testing.assert_array_equal(
        render_expected(plan, channels=False).electrons, render_expected(plan, channels=True).electrons
    )


def test_stray_light_is_on_unless_switched_off() -> None:
    camera = {key: value for key, value in LENS.items() if key not in ("bloom", "veiling_glare")}
    default = CameraSpec.model_validate(camera)
    assert default.bloom.share > 0
    assert default.veiling_glare > 0
    assert lens().direct_share == 1
    assert small_scenario(camera__bloom=BLOOM).sha256 != small_scenario().sha256


@pytest.mark.parametrize(
    ("values", "fragments"),
    [
        ({"camera__bloom": {"share": 0.7}}, ["camera.bloom.share", "<= 0.6"]),
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


def test_dew_scatters_a_share_of_the_light_far() -> None:
    camera = lens(dew={"share": 0.4, "core_px": 20, "slope": 3.0, "reach_px": 140})
    image = of_points(camera, 200, 150)[:, :, 0] / 0.4e6
    radius = np.hypot(np.arange(401) - 200, (np.arange(301) - 150)[:, None])
    assert camera.direct_share == pytest.approx(0.6)
    for within in (20, 50, 100):
        assert camera.dew is not None
        assert image[radius <= within].sum() == pytest.approx(encircled(camera.dew, within), abs=0.01)


def test_dust_shades_sky_and_stars_alike_in_all_frames() -> None:
    """The mean depth of many specks: a raised cosine's volume, (1/8 - 1/(2 pi^2)) pi d^2, by their number."""
    dust = {"specks": 400, "diameter_px": 30.0, "mean_depth": 0.02}
    frames = []
    for index in (0, 1):
        plain = render_expected(plan_frame(small_scenario(frames=2), index))
        frames.append(
            render_expected(plan_frame(small_scenario(frames=2, camera__dust=dust), index)).electrons / plain.electrons
        )
    np.testing.assert_allclose(frames[0], frames[1], rtol=1e-5)
    assert 0.5 < frames[0].min() < 0.98
    volume = 0.02 * math.pi * 30**2 * (0.125 - 0.5 / math.pi**2) * (1 + 0.3**2 / 3)
    area = (270 + 30) * (180 + 30)
    # 400 exponential depths: the mean is within 5 sigma of it, false alarm 6e-7.
    assert 1 - frames[0].mean() == pytest.approx(400 * volume / area, rel=5 * math.sqrt(2 / 400))
