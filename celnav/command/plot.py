"""Plot of an answer: the image, its detections, the identified stars by name, zenith and horizon."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celnav.adjustment import PARAMETERS, predict
from celnav.command.answer import Answer, match_names, position_texts
from celnav.command.whole_file import write_whole
from celnav.errors import ConfigError
from celnav.sky.catalog import load_catalog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

F8 = NDArray[np.float64]
# Largest number of identified stars drawn with a ring, and of those with a name; the others are drawn as dots.
MOST_RINGS, MOST_NAMES = 200, 24
# Least distance of named stars, as a fraction of the frame's width; otherwise names would overlap.
LEAST_APART = 0.04
# Width and resolution of the picture; if the image has more pixels than this, they are averaged over blocks.
_WIDTH_INCHES, _DPI = 11.0, 140
_FOUND, _OTHER, _FRAME = "#4fc3f7", "#9e9e9e", "#ffb74d"


def check_plot_path(path: str) -> None:
    """Raise `ConfigError` unless a PNG may be written to `path`."""
    if Path(path).suffix.lower() != ".png":
        raise ConfigError(f"--plot {path}: the picture is a PNG; give a name that ends in .png")
    if not Path(path).resolve().parent.is_dir():
        raise ConfigError(f"--plot {path}: its folder does not exist")


def draw(answer: Answer, image: NDArray[np.generic], path: str) -> None:
    """Draw an answer over its image.

    Parameters
    ----------
    answer : Answer
        The answer.
    image : ndarray, shape (height, width) or (height, width, 3)
        The image.
    path : str
        PNG to write; it appears only when it is complete.

    Raises
    ------
    ConfigError
        When the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = image.shape[:2]
    figure = Figure(figsize=(_WIDTH_INCHES, _WIDTH_INCHES * height / width + 0.8), dpi=_DPI, facecolor="black")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.4 / figure.get_figheight(), 1.0, 1 - 0.8 / figure.get_figheight()))
    shown, edges = _stretched(image, int(_WIDTH_INCHES * _DPI)), (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(shown, extent=edges, cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
    axes.set_axis_off()
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    _mark_stars(axes, answer)
    if answer.R_cam is not None and answer.camera is not None:
        _mark_horizon(axes, answer)
    figure.text(0.01, 1 - 0.2 / figure.get_figheight(), _title(answer), color="white", va="center", fontsize=11)
    figure.text(
        0.01, 0.2 / figure.get_figheight(),
        f"blue: identified (rings: the {MOST_RINGS} brightest); grey: bright and not identified; orange: altitudes, bearings",
        color=_OTHER, va="center", fontsize=9,
    )  # fmt: skip
    _save(figure, Path(path))


def _stretched(image: NDArray[np.generic], most_columns: int) -> NDArray[np.float64]:
    """Average over blocks, and stretch logarithmically, from the sky level to the brightest parts, to 0 to 1."""
    grey = image.astype(np.float32) if image.ndim == 2 else image[..., :3].astype(np.float32).mean(axis=2)
    block = max(1, grey.shape[1] // most_columns)
    rows, columns = (length // block * block for length in grey.shape)
    if block > 1 and rows and columns:
        grey = grey[:rows, :columns].reshape(rows // block, block, columns // block, block).mean(axis=(1, 3))
    low, middle, high = np.percentile(grey, [1, 50, 99.9])
    above = np.clip(grey - low, 0, None)
    # With twice the distance from dark to sky as the scale, the sky is dark grey, and faint stars stand out from it.
    scale = max(2 * float(middle - low), float(high - low) / 50, 1e-6)
    return np.asarray(np.clip(np.arcsinh(above / scale) / np.arcsinh(max(float(high - low) / scale, 1e-6)), 0, 1))


def _mark_stars(axes: Axes, answer: Answer) -> None:
    fix, uv = answer.fix, answer.detections.uv
    found = np.zeros(len(uv), dtype=bool)
    found[fix.matches[:, 0]] = True
    circle: dict[str, Any] = {"facecolors": "none", "linewidths": 0.7}
    unnamed = uv[~found][:MOST_RINGS]
    axes.scatter(unnamed[:, 0], unnamed[:, 1], s=18, edgecolors=_OTHER, alpha=0.8, **circle)
    order = _brightest(answer)
    at = uv[fix.matches[order, 0]]
    axes.scatter(at[:MOST_RINGS, 0], at[:MOST_RINGS, 1], s=60, edgecolors=_FOUND, **circle)
    axes.scatter(at[MOST_RINGS:, 0], at[MOST_RINGS:, 1], s=1.5, color=_FOUND, linewidths=0)
    names, labelled = match_names(fix), np.empty((0, 2))
    apart_px = LEAST_APART * float(np.ptp(axes.get_xlim()))
    for place, row in zip(at[:MOST_NAMES], order[:MOST_NAMES], strict=True):
        if (np.hypot(*(labelled - place).T) > apart_px).all():
            _label(axes, place, names[row], _FOUND)
            labelled = np.vstack((labelled, place))


def _brightest(answer: Answer) -> NDArray[np.intp]:
    """Return the matches in order of brightness; planets come first."""
    catalog, ids = load_catalog(), answer.fix.matches[:, 1]
    magnitude = np.full(len(ids), -9.0)
    is_star = np.isin(ids, catalog.star_id)
    magnitude[is_star] = catalog.v_mag[catalog.rows_of(ids[is_star])]
    return np.argsort(magnitude, kind="stable")


def _mark_horizon(axes: Axes, answer: Answer) -> None:
    """Draw the zenith, circles of altitude and the compass points, as far as they are in the frame."""
    assert answer.R_cam is not None
    for altitude_deg in (0, 30, 60):
        azimuth = np.arange(0, 361, 0.5)
        uv = _project(answer, azimuth, np.full_like(azimuth, altitude_deg))
        axes.plot(*uv.T, color=_FRAME, linewidth=1.4 if altitude_deg == 0 else 0.6, alpha=0.8)
        seen = np.flatnonzero(np.isfinite(uv[:, 0]))
        if len(seen):
            _label(axes, uv[seen[len(seen) // 2]], "horizon" if altitude_deg == 0 else f"{altitude_deg}°")
    for name, azimuth_deg in zip(("N", "NE", "E", "SE", "S", "SW", "W", "NW"), range(0, 360, 45), strict=True):
        altitude = np.arange(0.0, 89.0, 0.5)
        uv = _project(answer, np.full_like(altitude, azimuth_deg), altitude)
        axes.plot(*uv.T, color=_FRAME, linewidth=0.5, alpha=0.5)
        seen = np.flatnonzero(np.isfinite(uv[:, 0]))
        if len(seen):
            _label(axes, uv[seen[0]], name)
    zenith = _project(answer, np.zeros(1), np.full(1, 90.0))
    axes.plot(*zenith.T, marker="+", markersize=14, color=_FRAME)
    if np.isfinite(zenith[0, 0]):
        _label(axes, zenith[0], "zenith")


def _label(axes: Axes, uv: F8, text: str, colour: str = _FRAME) -> None:
    """Write text next to a position in the frame, towards the frame's centre."""
    from matplotlib.patheffects import withStroke

    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    to_right, up = uv[0] < (left + right) / 2, uv[1] > (bottom + top) / 2
    axes.annotate(
        text, (float(uv[0]), float(uv[1])), xytext=(6 if to_right else -6, 6 if up else -6), textcoords="offset points",
        color=colour, fontsize=9, ha="left" if to_right else "right", va="bottom" if up else "top", zorder=5,
        path_effects=[withStroke(linewidth=2.5, foreground="black", alpha=0.7)],
    )  # fmt: skip


def _project(answer: Answer, azimuth_deg: F8, altitude_deg: F8) -> F8:
    """Project horizontal directions, shape (n,), to pixels, shape (n, 2); NaN outside the frame."""
    assert answer.R_cam is not None
    assert answer.camera is not None
    azimuth, altitude = np.radians(azimuth_deg), np.radians(altitude_deg)
    enu = np.column_stack((np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)))
    fitted = (getattr(answer.fix.calibration, name) for name in PARAMETERS)
    values = np.array([0.0 if estimate is None else estimate.value for estimate in fitted])
    uv = predict(answer.camera, enu @ answer.R_cam.T, values)
    inside = np.isfinite(uv[:, 0]) & answer.camera.in_frame(np.nan_to_num(uv, nan=-1e9))
    return np.where(inside[:, None], uv, np.nan)


def _title(answer: Answer) -> str:
    fix, utc = answer.fix, answer.utc
    if fix.ok:
        return f"{'  '.join(position_texts(fix))}   {utc}   {len(fix.matches)} stars"
    return f"no fix: {fix.reason}   {utc}   {len(fix.matches)} stars"


def _save(figure: Any, path: Path) -> None:
    picture = io.BytesIO()
    figure.savefig(picture, format="png", facecolor=figure.get_facecolor())
    write_whole(path, picture.getvalue(), "--plot")
