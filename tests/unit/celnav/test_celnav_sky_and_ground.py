"""Detection tells sky from ground: what lies outside the sky neither makes stars nor changes how many are found in it."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from star_images import add_star, grid, nearest

import celnav
from celnav.detecting.image_background import Outstanding
from celnav.detecting.shape_stars import shape_of_bright
from celnav.detecting.star_candidates import Cores
from celnav.errors import ImageError
from celnav.reading.fits_file import read_fits

ALLSKY = Path(__file__).parents[2] / "data/allsky"
# Of the frames' camera: middle of the image circle, and pixels from the zenith to the horizon.
MIDDLE, HORIZON_PX, COUNTED_PX = (709.7, 489.6), 490.0, 380.0
SIZE = (360, 480)


@pytest.fixture(scope="module")
def night():
    """Photograph 008 of an observatory's all-sky camera, and the distance of its pixels from the zenith."""
    image = read_fits(ALLSKY / "008.fits.bz2").pixels
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return image, np.hypot(u - MIDDLE[0], v - MIDDLE[1])


def inside(found, offset=0.0):
    """Number of detections within 65 deg of the zenith; all have to lie in the frame."""
    width_height = np.array(found.shape[::-1])
    assert ((found.uv > -1) & (found.uv < width_height)).all()
    return int(np.sum(np.hypot(*(found.uv - offset - MIDDLE).T) < COUNTED_PX))


@pytest.mark.parametrize("border", [0, "mean", 255, 65535, "brighter", "darker", "bar", "frame"])
def test_nothing_outside_the_sky_changes_the_count_inside(night, border):
    image, from_zenith = night
    changed, outside, offset = image.copy(), from_zenith > HORIZON_PX, 0.0
    if border == "brighter":
        changed[outside] = np.minimum(changed[outside] * 3.0, 60_000).astype(np.uint16)
    elif border == "darker":
        changed[outside] //= 4
    elif border == "bar":
        changed[:, :60] = 65535
    elif border == "frame":
        changed, offset = np.pad(image, 64), 64.0
    else:
        changed[outside] = int(image.mean()) if border == "mean" else border
    assert inside(celnav.detect(changed), offset) == pytest.approx(inside(celnav.detect(image)), rel=0.05)


@pytest.mark.parametrize("reach_deg", [90, 85, 80, 75, 70])
def test_no_mask_outside_changes_the_count_inside(night, reach_deg):
    image, from_zenith = night
    found = celnav.detect(image, from_zenith > HORIZON_PX * reach_deg / 90)
    assert inside(found) == pytest.approx(inside(celnav.detect(image)), rel=0.05)


@pytest.mark.parametrize("margin", [37, 100])
def test_no_margin_changes_the_count_inside(night, margin):
    """Margins that put the frame's tiles elsewhere on the sky."""
    image, _ = night
    assert inside(celnav.detect(np.pad(image, margin)), margin) == pytest.approx(inside(celnav.detect(image)), rel=0.05)


def test_a_cloud_beside_a_star_does_not_widen_it():
    """Stars of 0.8 px, each with a step of light of a third of its peak beside it: the shape is that of the stars."""
    rng = np.random.default_rng(8)
    image = np.full(SIZE, 400.0)
    truth = stars_on(image, rng, (20_000, 40_000))
    cloudy = image + 1500 * (gaussian_filter(rng.normal(0, 1, SIZE), 12) > 0)
    counts = []
    for one in (image, cloudy):
        found = celnav.detect(rng.poisson(one).astype(np.uint16))
        counts.append(np.mean(nearest(found, truth)[0] < 1))
    assert counts[0] > 0.97
    assert counts[1] > 0.75


def test_sharp_stars_of_a_photograph_are_found(night):
    """A lens of 0.55 px: more than 1,500 within 65 deg of the zenith, where the catalogue has 2,000 to V 6."""
    assert inside(celnav.detect(night[0])) > 1500


def stars_on(image, rng, lights=(4000, 40_000), margin=16, where=None, sigma_px=1.0):
    """Add a star to every cell of a grid, and return the places."""
    truth = grid(rng, image.shape, step=30, margin=margin)
    truth = truth if where is None else truth[where(truth)]
    for (u, v), light in zip(truth, rng.permutation(np.geomspace(*lights, len(truth))), strict=True):
        add_star(image, u, v, light, sigma_px)
    return truth


@pytest.mark.parametrize("correlation_px", [0.7, 1.0, 1.5])
def test_correlated_noise_makes_no_stars(correlation_px):
    """Noise as video leaves it: of two million pixels 20 false stars at most, and the stars of 15 sigma are found."""
    rng = np.random.default_rng(4)
    blank, found = 0, []
    for _ in range(3):
        noise = gaussian_filter(rng.normal(0, 1, (800, 830)), correlation_px)
        noise *= 1.2 / noise.std()
        blank += len(celnav.detect(np.rint(30 + noise).astype(np.uint8)))
        image = np.zeros(noise.shape)
        truth = stars_on(image, rng, (15 * 1.2 * 6.3 * 2, 60 * 1.2 * 6.3))
        found.append(
            np.mean(nearest(celnav.detect(np.clip(np.rint(30 + noise + image), 0, 255).astype(np.uint8)), truth)[0] < 1)
        )
    assert blank <= 20
    assert np.mean(found) > 0.95


def ground(rng, size=SIZE):
    """A texture of leaves and walls, as bright as stars."""
    return 400 * gaussian_filter(rng.normal(0, 1, size), 1.2) + 300 * (gaussian_filter(rng.normal(0, 1, size), 4) > 0)


def test_trees_and_walls_are_no_stars():
    """Half of the frame is ground: stars of the other half are found, and few stars in it."""
    rng = np.random.default_rng(5)
    image = np.full(SIZE, 400.0)
    truth = stars_on(image, rng, where=lambda uv: uv[:, 1] < 170)
    image[190:] += ground(rng)[190:]
    found = celnav.detect(np.clip(rng.poisson(np.maximum(image, 1)), 0, 65535).astype(np.uint16))
    assert np.mean(nearest(found, truth)[0] < 1) > 0.97
    assert np.sum(found.uv[:, 1] > 196) < 0.1 * len(truth)


@pytest.mark.parametrize("brightness", [300, 3000, 30_000])
def test_a_bright_fence_does_not_hide_the_shape_of_the_stars(brightness):
    """Maxima of its slats are long and outnumber the 75 stars: these tell the shape, 0.6 px and the pixel's own width."""
    rng = np.random.default_rng(9)
    light = np.zeros(SIZE)
    stars_on(light, rng, where=lambda uv: uv[:, 1] < 150, sigma_px=0.6)
    light[170:] += brightness * np.abs(np.sin(np.arange(SIZE[1]) * np.pi / 9)) ** 4
    light += rng.normal(0, 20, SIZE)
    light = light.astype(np.float32)
    at = np.flatnonzero(np.pad(light[1:-1, 1:-1] > 100, 1))
    value = light.ravel()[at]
    far = Outstanding(at, value, value, np.full(len(at), 20, dtype=np.float32))
    shape = shape_of_bright(light, far, Cores(np.empty((0, 2)), np.empty(0), np.inf))
    assert shape is not None
    variance = 0.6**2 + 1 / 12
    assert np.abs(shape.at(np.array([[240.0, 80.0]]))[0] - [variance, 0, variance]).max() < 0.05


def fixed_camera(rng, frames=6, turned=True):
    """Frames of a camera with ground below row 280, a black border, and hot pixels; and where those are."""
    texture = ground(rng)
    hot = rng.integers(20, 260, 40), rng.integers(60, 460, 40)
    still = grid(rng, SIZE, step=24)
    result = []
    for _ in range(frames):
        image = np.full(SIZE, 400.0)
        places = grid(rng, SIZE, step=24) if turned else still
        for u, v in places[rng.random(len(places)) < 0.8] if turned else places:
            add_star(image, u + 8 * (rng.random() - 0.5) * turned, v, 6000.0)
        image[280:] = 400 + texture[280:]
        image = rng.poisson(np.maximum(image, 1)).astype(np.float64)
        image[hot] += 3000
        image[:, :40] = 0
        result.append(np.clip(image, 0, 65535).astype(np.uint16))
    return result, hot


def test_a_mask_is_learnt_from_frames():
    frames, hot = fixed_camera(np.random.default_rng(6))
    mask = celnav.sky_mask(frames)
    assert mask.dtype == np.bool_
    assert mask[hot].all()
    assert mask[290:].mean() > 0.95
    assert mask[:, :30].mean() > 0.95
    assert mask[10:265, 60:470].mean() < 0.05
    found = celnav.detect(frames[0], mask)
    assert (found.uv[:, 1] < 290).all()


def test_faint_lights_that_stand_still_are_masked():
    """Lights of 5 sigma at the same places of six frames; the sky around them stays, and so do the stars that move."""
    rng = np.random.default_rng(12)
    still = grid(rng, SIZE, step=60, margin=20)
    frames = []
    for _ in range(6):
        image = np.full(SIZE, 400.0)
        for u, v in grid(rng, SIZE, step=40):
            add_star(image, u + 8 * (rng.random() - 0.5), v, 6000.0)
        for u, v in still:
            add_star(image, u, v, 400.0)
        frames.append(rng.poisson(image).astype(np.uint16))
    mask = celnav.sky_mask(frames)
    u, v = np.rint(still).astype(int).T
    assert mask[v, u].mean() > 0.6
    assert mask.mean() < 0.05


def test_sky_beside_dark_trees_is_sky():
    """Trees fill most of the tiles along row 250: the sky above them is brighter than those tiles, and no ground."""
    rng = np.random.default_rng(11)
    edge = 250 + 12 * gaussian_filter(rng.normal(0, 6, SIZE[1]), 6)
    rows = np.arange(SIZE[0])[:, None]
    frames = []
    for _ in range(5):
        image = np.full(SIZE, 1200.0)
        for u, v in grid(rng, SIZE, step=20, margin=4):
            add_star(image, u, v, 8000.0, 0.8)
        image[rows > edge] = 300
        frames.append(rng.poisson(image).astype(np.uint16))
    mask = celnav.sky_mask(frames)
    assert mask[(rows < edge - 5) & (rows > edge - 30)].mean() < 0.2
    assert mask[(rows > edge + 3) & (rows < 355)].mean() > 0.95


def test_a_mask_needs_frames_between_which_the_sky_turned():
    rng = np.random.default_rng(7)
    frames, _ = fixed_camera(rng, 3, turned=False)
    with pytest.raises(ImageError, match="turned"):
        celnav.sky_mask(frames)
    with pytest.raises(ImageError, match="3 frames or more"):
        celnav.sky_mask(frames[:2])
    with pytest.raises(ImageError, match="one size"):
        celnav.sky_mask([*frames[:2], frames[2][:-1]])
    with pytest.raises(ImageError, match="real numbers"):
        celnav.sky_mask([frame > 0 for frame in frames])


def test_black_frames_have_no_sky():
    """Without any detection nothing is learnt but that nothing stands out."""
    assert not celnav.sky_mask([np.zeros(SIZE, dtype=np.uint8)] * 3).any()
