"""Images of stars with known truth, made with numpy alone: Gaussians integrated over pixels, and streaks of them."""

import numpy as np
from scipy.special import erf


def add_star(image, u, v, light, sigma_px=1.0, reach=None):
    """Add a pixel-integrated Gaussian of total light at (u, v)."""
    reach = int(np.ceil(7 * sigma_px)) if reach is None else reach
    columns, rows = np.rint(u) + np.arange(-reach, reach + 1), np.rint(v) + np.arange(-reach, reach + 1)
    columns = columns[(columns >= 0) & (columns < image.shape[1])].astype(int)
    rows = rows[(rows >= 0) & (rows < image.shape[0])].astype(int)
    if len(rows) and len(columns):
        image[np.ix_(rows, columns)] += light * np.outer(_part(rows - v, sigma_px), _part(columns - u, sigma_px))


def _part(x, sigma_px):
    return 0.5 * (erf((x + 0.5) / sigma_px / 2**0.5) - erf((x - 0.5) / sigma_px / 2**0.5))


def add_streak(image, u, v, light, du, dv, sigma_px=1.0):
    """Add a star that moves by (du, dv) during the exposure, its middle at (u, v)."""
    n = max(1, int(np.ceil(3 * np.hypot(du, dv) / sigma_px)))
    for part in (np.arange(n) + 0.5) / n - 0.5:
        add_star(image, u + part * du, v + part * dv, light / n, sigma_px)


def grid(rng, size=(360, 480), step=24, margin=16):
    """Positions, one in every cell of a grid, none near the border, shape (n, 2)."""
    v, u = np.mgrid[margin : size[0] - margin : step, margin : size[1] - margin : step]
    places = np.column_stack((u.ravel(), v.ravel())).astype(float)
    return places + rng.uniform(-3, 3, places.shape)


def scattered(rng, number, apart, margin, size=(360, 480)):
    """Places without any order, which would correlate, that far from each other and from the border, shape (number, 2)."""
    places = []
    while len(places) < number:
        place = rng.uniform(margin, np.array([size[1], size[0]]) - margin)
        if all(np.hypot(*(place - other)) > apart for other in places):
            places.append(place)
    return np.array(places)


def nearest(found, truth):
    """Distance of each truth from the nearest detection, and which that is."""
    distance = np.linalg.norm(found.uv[None] - truth[:, None], axis=2) if len(found) else np.full((len(truth), 1), 1e9)
    return distance.min(axis=1), distance.argmin(axis=1)
