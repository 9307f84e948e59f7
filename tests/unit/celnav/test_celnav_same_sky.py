"""The same sky shows the same stars however it is turned, mirrored, laid in memory, or written in numbers."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import celnav
from celnav.detecting.tiles import Tiles
from celnav.reading.fits_file import read_fits

ALLSKY = Path(__file__).parents[2] / "data/allsky"


@pytest.fixture(scope="module")
def night():
    """A photograph of an observatory's all-sky camera, and what is detected in it."""
    image = read_fits(ALLSKY / "008.fits.bz2").pixels
    return image, celnav.detect(image)


@pytest.mark.parametrize(("turns", "mirrored"), [(1, False), (2, False), (0, True), (3, True)])
def test_a_picture_that_is_turned_shows_the_same_stars(night, turns, mirrored):
    """Every star to a pixel; views of the array are as good as copies."""
    image, found = night
    turned = np.rot90(image.T if mirrored else image, turns)
    assert not turned.flags.c_contiguous
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    v, u = (np.rot90(each.T if mirrored else each, turns) for each in (v, u))
    again = celnav.detect(turned)
    assert len(again) == pytest.approx(len(found), rel=0.002)
    at = np.rint(again.uv).astype(int)
    back = np.column_stack((u[at[:, 1], at[:, 0]], v[at[:, 1], at[:, 0]]))
    apart = np.linalg.norm(back[:, None] - found.uv[None], axis=2).min(axis=1)
    assert np.mean(apart < 1.0) > 0.998


@pytest.mark.parametrize(("side", "tile_px"), [(1040, 32), (1391, 32), (101, 8), (64, 32), (97, 4)])
@pytest.mark.parametrize("paired", [True, False])
def test_tiles_sample_alike_from_either_end(side, tile_px, paired):
    image = np.add.outer(np.arange(side), np.zeros(side, dtype=int))
    for tiles in Tiles.of((side, side), tile_px).both:
        sampled = tiles.pairs(image) if paired else tiles.spread_samples(image)
        rows = np.unique(sampled)
        assert rows.min() >= 0
        assert rows.max() < side
        assert set(rows) == set(side - 1 - rows)


@pytest.mark.parametrize("change", ["times 0.5", "times 1000", "plus 5000", "eight bits", "steps of 7"])
def test_other_numbers_for_the_same_light(night, change):
    image, found = night
    light = image.astype(np.float64)
    if change == "times 0.5":
        changed, as_before = light * 0.5, found
    elif change == "times 1000":
        changed, as_before = light * 1000, found
    elif change == "plus 5000":
        changed, as_before = light + 5000, found
    else:
        few = np.rint(np.clip(light / 40, 0, 255)).astype(np.uint16)
        changed = few * 7 if change == "steps of 7" else few
        as_before = found if change == "eight bits" else celnav.detect(few)
    assert len(celnav.detect(changed)) == pytest.approx(len(as_before), rel=0.1 if change == "eight bits" else 0.02)


@pytest.mark.parametrize(
    ("rises_px", "correlation_px", "most"), [(None, 0, 3), (None, 0.6, 80), (20, 0, 3), (20, 0.6, 20)]
)
def test_noise_of_a_quarter_of_a_step_makes_few_stars(rises_px, correlation_px, most):
    """Of half a million pixels, on a sky that is level or rises by a step in some pixels; and as many with larger steps."""
    rng = np.random.default_rng(3)
    noise = gaussian_filter(rng.normal(0, 1, (600, 800)), correlation_px)
    sky = 8.2 + (0 if rises_px is None else np.arange(800) / rises_px) + 0.25 * noise / noise.std()
    few = np.rint(sky).astype(np.uint16)
    found = celnav.detect(few)
    assert len(found) <= most
    assert len(celnav.detect(7 * few)) == pytest.approx(len(found), abs=1)
