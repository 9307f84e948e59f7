"""Plot of a calibration's residuals: every star, and the means over cells of the frame."""

from __future__ import annotations

import io
import textwrap
from pathlib import Path

import numpy as np

from celnav.calibrating.calibration import CameraCalibration
from celnav.calibrating.verdict import verdict
from celnav.command.whole_file import write_whole
from celnav.errors import ConfigError

_STAR_SCALE, _MEAN_SCALE = 150.0, 600.0  # pixels of the frame for each pixel of residual
_SUFFIXES = (".png", ".svg", ".pdf")


def check_map_path(path: str) -> None:
    """Raise `ConfigError` if no picture can be written to `path`, before any work is done."""
    if Path(path).suffix.lower() not in _SUFFIXES:
        raise ConfigError(f"--map {path}: the name must end in {', '.join(_SUFFIXES)}")
    if not Path(path).resolve().parent.is_dir():
        raise ConfigError(f"--map {path}: its folder does not exist")


def draw_residual_map(found: CameraCalibration, path: str) -> None:
    """Draw residuals over the frame: those of each star on the left, means of cells with their noise on the right."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    camera, seen, pattern = found.camera, found.residuals, found.pattern
    figure = Figure(figsize=(13, 1.9 + 6.0 * camera.height / camera.width), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    size = np.hypot(*seen.off_px.T)
    arrows = left.quiver(
        *seen.uv.T, *(seen.off_px * _STAR_SCALE).T, size, angles="xy", scale_units="xy", scale=1, width=0.0016,
        cmap="viridis", clim=(0, float(np.quantile(size, 0.98))),
    )  # fmt: skip
    figure.colorbar(arrows, ax=left, label="residual, px", location="bottom", shrink=0.6, aspect=40)
    left.set_title(f"{len(size)} stars, arrows x {_STAR_SCALE:.0f}")
    right.quiver(
        *pattern.centre_px.T, *(pattern.mean_px * _MEAN_SCALE).T, angles="xy", scale_units="xy", scale=1, width=0.003
    )
    for (u, v), sigma in zip(pattern.centre_px.tolist(), pattern.sigma_px.tolist(), strict=True):
        right.add_patch(Circle((u, v), sigma * _MEAN_SCALE, fill=False, color="0.7", linewidth=0.7))
    right.set_title(f"means of cells, arrows x {_MEAN_SCALE:.0f}; circles: their standard deviation")
    for axes in (left, right):
        axes.set_xlim(-0.5, camera.width - 0.5)
        axes.set_ylim(camera.height - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.set_xlabel("u, px")
        axes.plot(camera.cx_px, camera.cy_px, "+", color="tab:red")
    left.set_ylabel("v, px")
    figure.suptitle(textwrap.fill(verdict(found), 130), fontsize=11)
    picture = io.BytesIO()
    figure.savefig(picture, format=Path(path).suffix[1:].lower())
    write_whole(path, picture.getvalue(), "--map")
