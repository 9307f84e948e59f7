"""What the renderer leaves out to be fast, against the long way: every bound that the code states."""

import numpy as np
import pytest
from scipy import interpolate, ndimage, special
from small_scenes import small_scenario

from generator import plugins
from generator.errors import GeneratorError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import field_radius_deg, plan_frame
from generator.frame.record import _around, _brightness_order
from generator.frame.scene import camera_dict, frame_layers, scene_dict
from generator.frame.star_truth import share_within
from generator.light.atmosphere import Atmosphere, optical_depth
from generator.light.photometry import GRID_NM
from generator.light.stellar_spectra import colour_grid, colour_place, star_spectra
from generator.scenario.projection import Projection
from generator.sky.directions import sky_grid
from generator.sky.zodiacal import upsampled

PSF = {
    "diffraction": {"f_number": 2.0, "coma_waves": 0.2, "astigmatism_waves": 0.2}, "gaussian_sigma_px": 0.5,
    "support_px": 8,
}  # fmt: skip


@pytest.fixture(scope="module")
def mi():
    return plugins.start()


def test_table_of_star_electrons_against_each_star_s_own_integral(mi) -> None:
    """For every colour and airmass up to the horizon's, by channel and band: within 1e-4 in clear, 5e-4 in hazy air."""
    from generator.plugins.film_response import FilmResponse

    wavelength = np.linspace(352, 998, 132)
    curves = np.stack([np.exp(-(((wavelength - centre) / 90) ** 2)) for centre in (460, 540, 640)])
    response = FilmResponse(wavelength, curves * 650 / 132)
    vi_mag = np.repeat(np.linspace(-0.4, 4.4, 40), 50)
    bv_mag = np.linspace(-0.4, 4.0, 2000)[np.random.default_rng(7).permutation(2000)]
    airmass = np.tile(np.concatenate([[0.0], np.geomspace(1.0, 38.0, 49)]), 40)
    spectra = star_spectra(np.zeros(2000), bv_mag, vi_mag)
    place = np.interp(wavelength, GRID_NM, np.arange(len(GRID_NM)))
    for aerosol, tolerance in ((0.1, 1e-4), (0.6, 5e-4)):
        depth = optical_depth(GRID_NM, Atmosphere(1013.0, aerosol, 1.3, 300.0))
        left = np.minimum(place.astype(int), len(GRID_NM) - 2)
        right = place - left
        shape, tau = ((1 - right) * x[..., left] + right * x[..., left + 1] for x in (spectra, depth))
        light = shape * np.exp(-airmass[:, None] * tau)
        found = response.of_stars(colour_grid().spectra, depth, *colour_place(bv_mag, vi_mag), airmass, 4)
        band = ((wavelength - 350) / 162.5).astype(int)
        for number in range(4):
            wanted = light[:, band == number] @ response.electrons[:, band == number].T
            np.testing.assert_allclose(found[:, :, number], wanted, rtol=tolerance)


@pytest.mark.parametrize("sensor", [{}, {"rolling_shutter": {"line_time_us": 200}}], ids=["global", "rolling"])
def test_rotations_once_a_line_give_the_rays_of_each_place(mi, sensor) -> None:
    """To the bit, also of places beside the pixels' middles and of a choice of pixels."""
    import drjit as dr

    from generator.plugins.camera import FLOAT64, FilmPoints

    plan = plan_frame(small_scenario(sensor=sensor, motion={"rate_deg_s": [9.0, -4.0, 20.0], "samples": 8}), 0)
    camera = mi.load_dict(camera_dict(plan))
    assert camera.keyframes == 8
    chosen = mi.UInt32(np.arange(5, camera.width * camera.height, 3))
    whole = FilmPoints.middles(camera.width, camera.height)
    for points in (whole, whole.of(chosen).moved(mi.Vector2f(0.25 / camera.width, -0.25 / camera.height))):
        for share in (0.125, 0.5):
            by_line = camera.line_ray(dr.opaque(FLOAT64, share), points)
            each = camera.pixel_ray(dr.opaque(FLOAT64, share), points.position)
            for one, other in zip(by_line, each, strict=True):
                pair = [np.array(part.d if hasattr(part, "d") else part) for part in (one, other)]
                np.testing.assert_array_equal(*pair)
            times = [np.broadcast_to(np.array(ray.time), dr.width(points.line)) for ray in (by_line[0], each[0])]
            np.testing.assert_array_equal(*times)


def test_the_sky_as_the_camera_s_channels_see_it_is_the_spectral_sky(mi) -> None:
    """A colour camera's three channels against Mitsuba's own way over the spectral emitter: within 0.1 %."""
    plan = plan_frame(small_scenario(sensor={"colour": {"pattern": "RGGB"}}, stars={"limiting_magnitude": -1.9}), 0)
    frame = render_expected(plan)
    spectral = np.array(mi.render(mi.load_dict(scene_dict(plan))))
    for number, name in enumerate(("blue", "green", "red")):
        np.testing.assert_allclose(frame.channels[name], spectral[:, :, number], rtol=1e-3)


@pytest.mark.parametrize("psf", [None, PSF])
def test_small_stamps_of_faint_stars(mi, psf, monkeypatch) -> None:
    """Against whole stamps: light is conserved within 0.1 %, and no pixel changes by more than the stated bounds."""
    from generator.plugins import stamp_light

    optics = {} if psf is None else {"camera__psf": psf, "camera__pixel_pitch_um": 4.0}
    plan = plan_frame(small_scenario(sky=None, stars={"limiting_magnitude": 7.5}, **optics), 0)
    small = render_expected(plan).electrons.astype(float)
    monkeypatch.setattr(stamp_light, "FAINTEST_PIXEL_E", 0.0)
    whole = render_expected(plan).electrons.astype(float)
    assert (small != whole).any()
    assert small.sum() == pytest.approx(whole.sum(), rel=1e-3)
    # A few stars may overlap in a pixel.
    bound = 3 * 0.05 + stamp_light.LARGEST_MOVED_SHARE * whole
    assert (np.abs(small - whole) < bound).all()


def test_stamps_keep_their_promises(mi) -> None:
    """The chosen radius is the smallest of its kind that leaves out no pixel and no share larger than stated."""
    from generator.plugins.stamp_light import FAINTEST_PIXEL_E, LARGEST_MOVED_SHARE, SIZES_PX, gaussian_light

    light = gaussian_light(1.5, 10)
    electrons = np.geomspace(0.1, 1e6, 200)
    radius = light.radii(electrons)
    assert (np.diff(radius) >= 0).all()
    assert set(radius) <= {*SIZES_PX, 10}
    fits = radius < 10
    assert (electrons[fits] * light.beyond[radius[fits]] <= FAINTEST_PIXEL_E).all()
    assert (1 - 1 / light.gain[radius, 0, 0, 0] <= LARGEST_MOVED_SHARE)[fits].all()


@pytest.mark.parametrize("copies_bytes", [0, 1 << 28])
@pytest.mark.parametrize("width", [24, 21])
def test_packets_of_pixels_add_up_as_single_ones(mi, width, copies_bytes, monkeypatch) -> None:
    """Stamps at random places, over every edge of the image too, against NumPy's sum pixel by pixel; no bit differs."""
    from generator.plugins import star_splats

    monkeypatch.setattr(star_splats, "COPIES_BYTES", copies_bytes)
    random, height, taps, lanes = np.random.default_rng(5), 15, 7, 5000
    left, row = random.integers(-12, width + 4, lanes), random.integers(-5, height + 5, lanes)
    electrons = random.integers(0, 1000, (2, taps, lanes))
    total = star_splats.LightSum(width, height, 2)
    rows = star_splats.StampRows(
        moment=np.arange(lanes),
        radius=6,
        taps=taps,
        parts=2,
        owner=None,
        du=None,
        dv=None,
        left=mi.Int32(left),
        row=mi.Int32(row),
        inside=mi.Int32(np.where(np.arange(lanes) % 2, 6, 13)),
    )
    rows.add(total, [[mi.Float(electrons[plane, tap]) for plane in range(2)] for tap in range(taps)], few=False)
    wanted = np.zeros((height, width, 2))
    for tap in range(taps):
        column = left + tap
        seen = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        seen &= (tap < 6) | (np.arange(lanes) % 2 == 0)
        for plane in range(2):
            np.add.at(wanted[:, :, plane], (row[seen], column[seen]), electrons[plane, tap][seen])
    np.testing.assert_array_equal(np.array(total.image()), wanted)


@pytest.mark.parametrize("psf", [None, PSF])
def test_light_beyond_any_sensor_does_not_wrap_around(mi, psf) -> None:
    """A lamp that gives a pixel 1e14 electrons or more: the image of a weak one, scaled."""
    optics = {} if psf is None else {"camera__psf": psf, "camera__pixel_pitch_um": 4.0}
    lamp = {"azimuth_deg": 180.0, "altitude_deg": 80.0, "distance_m": 2.0}
    weak, strong = (
        render_expected(plan_frame(small_scenario(
            sky=None, stars={"limiting_magnitude": -2.0}, foreground={"lamps": [lamp | {"intensity_cd": candela}]}, **optics
        ), 0)).electrons.astype(float)
        for candela in (1e-2, 1e6)
    )  # fmt: skip
    assert strong.max() > 1e14
    bright = weak > 1e-3 * weak.max()
    np.testing.assert_allclose(strong[bright], 1e8 * weak[bright], rtol=1e-5)
    assert strong.sum() == pytest.approx(1e8 * weak.sum(), rel=1e-3)


def test_units_of_the_sum_follow_the_light() -> None:
    """2^24 for ordinary light; for more the sum stays within 64 bits; what is not a number is refused."""
    from generator.plugins.star_splats import units_per_electron

    for electrons in (0.0, 1.0, 1e9, 2.0**38 - 1):
        assert units_per_electron(electrons) == 2.0**24
    for electrons in (2.0**38, 1e12, 1e14, 1e20, 9e29):
        assert 2.0**61 < electrons * units_per_electron(electrons) < 2.0**64
    for electrons in (1e30, np.inf, np.nan):
        with pytest.raises(GeneratorError, match=r"expected less than 1e\+30; make the lights fainter"):
            units_per_electron(electrons)


def test_a_sum_of_a_1e14_electron_pixel(mi) -> None:
    """Two lights of 1e14 electrons and one of 1e5 in a pixel of one plane, in 64 bits."""
    from generator.plugins import star_splats

    total = star_splats.LightSum(8, 4, 1, 3e14)
    whole = np.array([1e14, 1e14, 1e5], np.float32)
    rows = star_splats.StampRows(
        moment=np.arange(3), radius=0, taps=1, parts=1, owner=None, du=None, dv=None,
        left=mi.Int32([3, 3, 3]), row=mi.Int32([2, 2, 2]), inside=mi.Int32([1, 1, 1]),
    )  # fmt: skip
    rows.add(total, [[mi.Float(whole)]], few=False)
    wanted = np.zeros((4, 8, 1))
    wanted[2, 3, 0] = whole.astype(float).sum()
    np.testing.assert_allclose(np.array(total.image()), wanted, rtol=1e-7)


@pytest.mark.parametrize(("motion", "camera"), [
    ({"rate_deg_s": [2.0, -1.0, 4.0], "samples": 32}, {}),
    ({"gimbal": {"sigma_deg": 0.3, "correlation_s": 0.1}, "samples": 64}, {}),
    # Cells on the rim hold stars far beyond it, whose steps do not count.
    ({"rate_deg_s": [12.8, 9.6, 0.0]}, {"camera__hfov_deg": 60, "camera__width": 640, "camera__height": 480}),
])  # fmt: skip
def test_a_few_stars_show_how_all_move(mi, motion, camera, monkeypatch) -> None:
    """Against following every star at every attitude: the same stars, light within 0.1 %, centroids within 0.02 px."""
    from generator.plugins import star_paths

    plan = plan_frame(
        small_scenario(
            motion=motion,
            sky=None,
            stars={"limiting_magnitude": 6.0},
            sensor={"rolling_shutter": {"line_time_us": 100.0}},
            **camera,
        ),
        0,
    )
    probed = render_expected(plan)
    monkeypatch.setattr(star_paths, "FEW_SHARES", np.linspace(0, 1, 10_000))
    followed = render_expected(plan)
    inside = followed.fraction_in_frame > 0.01
    assert inside.sum() > 50
    np.testing.assert_allclose(probed.star_electrons[inside], followed.star_electrons[inside], rtol=1e-3)
    np.testing.assert_allclose(probed.centroid_px[inside], followed.centroid_px[inside], atol=0.02)
    np.testing.assert_allclose(probed.start_px[inside], followed.start_px[inside], atol=1e-6)
    np.testing.assert_allclose(probed.fraction_in_frame, followed.fraction_in_frame, atol=5e-3)
    assert np.abs(probed.electrons - followed.electrons).max() < 0.03 * followed.electrons.max()


CAMERAS = {
    "pinhole": Projection("pinhole", 300.0, 310.0, 250.0, 150.0),
    "brown_conrady": Projection("brown_conrady", 300.0, 300.0, 250.0, 150.0, k=(-0.2, 0.02), p=(0.002, -0.003)),
    "kannala_brandt": Projection("kannala_brandt", 200.0, 200.0, 250.0, 150.0, k=(0.01, -0.002)),
    "equidistant": Projection("equidistant", 200.0, 200.0, 250.0, 150.0),
    "off axis": Projection(
        "equidistant",
        200.0,
        200.0,
        250.0,
        150.0,
        p=(0.001, -0.002),
        s=(0.003, 0.0, -0.002, 0.0),
        tilt_rad=(0.02, -0.01),
    ),
    "pinhole off axis": Projection(
        "pinhole", 300.0, 310.0, 250.0, 150.0, p=(0.004, -0.003), s=(0.01, 0.0, -0.01, 0.0), tilt_rad=(0.1, -0.05)
    ),
    "stereographic": Projection("stereographic", 150.0, 150.0, 250.0, 150.0),
    "orthographic": Projection("orthographic", 200.0, 200.0, 250.0, 150.0),
}


@pytest.mark.parametrize("model", sorted(CAMERAS))
def test_no_pixel_looks_beyond_the_field_s_radius(mi, model) -> None:
    """Every pixel of a frame against the angle within which its stars are looked for; and that is not much too large."""
    import drjit as dr

    from generator.plugins.lens import make_lens

    projection = CAMERAS[model]
    width, height = 520, 330
    double = dr.float64_array_t(mi.Float)
    lens = make_lens(projection, lambda value: dr.opaque(double, value))
    u, v = np.meshgrid(np.linspace(-0.5, width - 0.5, 60), np.linspace(-0.5, height - 0.5, 40))
    _, _, z, valid = lens.unproject(double(u.ravel()), double(v.ravel()))
    seen = np.degrees(np.arccos(np.clip(np.array(z)[np.array(valid)], -1, 1)))
    found = projection.angle_deg(projection.corner_px(width, height))
    assert seen.max() <= found + 1e-6
    assert found < seen.max() + (6 if projection.centred else 12)


def test_the_field_s_radius_holds_the_reach_of_the_light() -> None:
    camera = small_scenario().frame(0).camera
    wider = camera.model_copy(update={"psf_sigma_px": 6.0})
    assert field_radius_deg(wider) > field_radius_deg(camera) > 0


def test_stars_are_listed_by_magnitude_and_id() -> None:
    """One sort of whole numbers, against NumPy's of two keys, with magnitudes that single precision cannot tell apart."""
    random = np.random.default_rng(8)
    v_mag = np.round(random.uniform(-2, 3, 5000), 2) + random.choice([0.0, 1e-9], 5000)
    v_mag[:7] = [0.0, -0.0, -1.46, -1e-30, 1e-30, -12.7, 15.0]
    star_id = random.permutation(np.arange(-2500, 2500)).astype(np.int32)
    star_id[7:11] = [2**31 - 1, -(2**31), 900_000_199, 0]
    found = np.argsort(_brightness_order(v_mag, star_id), kind="stable")
    np.testing.assert_array_equal(found, np.lexsort((star_id, v_mag.astype(np.float32))))


def test_pixels_around_marked_ones() -> None:
    marked = np.random.default_rng(9).random((40, 60)) < 0.02
    marked[0, 0] = marked[-1, 30] = True
    np.testing.assert_array_equal(_around(marked), ndimage.maximum_filter(marked, 3))
    assert not _around(np.zeros((4, 5), bool)).any()


def test_light_that_falls_wholly_on_the_frame_is_1() -> None:
    """Where the error function is left out, it would have given 1 to the last bit."""
    position = np.concatenate([np.linspace(-30, 130, 5001), [9 * 0.8, 99 - 9 * 0.8]])
    scale = np.sqrt(2) * 0.8
    wanted = 0.5 * (special.erf((99.5 - position) / scale) - special.erf((-0.5 - position) / scale))
    np.testing.assert_array_equal(share_within(position, 100, 0.8), wanted)


def test_a_coarse_map_is_interpolated_along_both_axes() -> None:
    """Against SciPy, in single precision; azimuth closes."""
    grid, random = sky_grid(), np.random.default_rng(10)
    rows = np.unique(np.append(np.arange(0, grid.shape[0], 7), grid.shape[0] - 1))
    columns = np.arange(0, grid.shape[1], 6)
    coarse = random.uniform(1, 2, (len(rows), len(columns)))
    closed = interpolate.RegularGridInterpolator(
        (rows, np.append(columns, grid.shape[1])), np.append(coarse, coarse[:, :1], axis=1)
    )
    wanted = closed(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1))
    np.testing.assert_allclose(upsampled(coarse, rows, columns, grid.shape), wanted, rtol=1e-6)


def test_means_over_azimuth_are_those_of_the_whole_maps() -> None:
    """Of components with few columns, with patterns, with both and with neither, below and above cloud."""
    values = {"time": {"utc_start": "2020-01-09T17:15:00Z", "exposure_s": 1.0}, "sky": {"bortle": 4}}
    plan = plan_frame(small_scenario(**values, sky__clouds={"mean_optical_depth": 0.3, "coverage": 0.5}), 0)
    tables = [
        part for table in frame_layers(plan).values() for part in (table, *(behind for _, behind in table.veiled))
    ]
    assert any(table.across is not None and table.pattern is None for table in tables)
    assert any(table.across is not None and table.pattern is not None for table in tables)
    for table in tables:
        whole = table.maps.astype(float).mean(axis=2)
        np.testing.assert_allclose(table.azimuth_mean, whole, rtol=2e-5, atol=1e-6 * np.abs(whole).max())
