"""Figures of docs/solver.md, one per stage of the solver: python tools/solver_figures.py docs/images."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator
from scipy.spatial import cKDTree

import celnav
from benchmark.fields.solver_bars import attitude_of, camera_of, measure, solve_field
from benchmark.fields.solver_fields import Condition, make_field
from benchmark.fields.solver_times import image_of
from benchmark.judge.geodesy import geodesic_km
from celnav.identification import identify
from celnav.sequences.track import KM_PER_DEG, Track, moved, offset_km
from celnav.sky.catalog import load_catalog
from generator.drawing.palette import SERIES, SOFT
from generator.drawing.style import axes_at, house_style, new_figure
from generator.drawing.svg import standalone_svg

CONDITION = Condition("figure", noise_px=0.5, missing=0.5, false=1.0)
BLUE, RED, GREY = SERIES[0].light, SERIES[7].light, SOFT.light
WIDTH_PX = 560


def new_axes(height_px: int, x: str, y: str, log: str = "") -> Axes:
    """Axes with titles, logarithmic for those named in `log`; the title of y is above its axis."""
    figure = new_figure(WIDTH_PX + 80, height_px + 80)
    axes = axes_at(figure, 56, 32, WIDTH_PX, height_px)
    axes.set(xlabel=x, xscale="log" if "x" in log else "linear", yscale="log" if "y" in log else "linear")
    axes.annotate(y, (0.0, 1.0), (-52.0, 12.0), "axes fraction", "offset points")
    return axes


def save(axes: Axes, path: Path, label: str) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.3)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            low, high = axis.get_view_interval()
            if high < 100.0 * low:
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
    path.write_text(standalone_svg(axes.figure, label), encoding="utf-8")
    print(path, path.stat().st_size)


def detection(folder: Path) -> None:
    """Share of the stars found against magnitude, by the matched filter and by flood fill, on the same images."""
    condition = Condition("detection", v_max=8.0)
    edges = np.arange(5.0, 8.01, 0.25)
    configs = {"matched filter": celnav.DetectionConfig(), "flood fill": celnav.FloodFillConfig()}
    found = {name: np.zeros(len(edges) - 1) for name in configs}
    total = np.zeros(len(edges) - 1)
    for number in range(4):
        field, image = make_field(condition, 13, number), image_of(condition, 13, number)
        v_mag = -2.5 * np.log10(field.flux)
        # Stars with another star within four pixels are left out.
        near = cKDTree(field.uv).query_pairs(4.0, output_type="ndarray")
        alone = np.ones(len(field.uv), dtype=bool)
        alone[near.ravel()] = False
        total += np.histogram(v_mag[alone], edges)[0]
        for name, config in configs.items():
            seen = cKDTree(celnav.detect(image, config=config).uv).query(field.uv)[0] < 1.5
            found[name] += np.histogram(v_mag[alone & seen], edges)[0]
    axes = new_axes(260, "V, mag", "share of single stars found")
    for (name, counts), colour, marker in zip(found.items(), (BLUE, GREY), "os", strict=True):
        axes.plot((edges[:-1] + edges[1:]) / 2, counts / total, marker=marker, color=colour, label=name)
    save(axes, folder / "solver_detection.svg", "Share of single stars found against magnitude")


def hypotheses(folder: Path, field) -> None:
    """Soft counts of all hypotheses of the stages up to the one that passes."""
    seen = []
    original = identify.best_hypotheses

    def spy(rotations, view, tolerance, level, index, most, first_look):
        weight = (1 / (tolerance * view.radians_per_px) ** 2).astype(np.float32)
        from celnav.identification.search import soft_count

        seen.append((rotations, soft_count(rotations, view.rays, weight, level, index)))
        return original(rotations, view, tolerance, level, index, most, first_look)

    identify.best_hypotheses = spy
    try:
        fix = solve_field(CONDITION, field)
    finally:
        identify.best_hypotheses = original
    # The chunk that contained the right one; a search for a rival may have followed.
    rotations, scores = max(seen, key=lambda chunk: float(chunk[1].max(initial=0.0)))
    turn = np.einsum("hij,ji->h", rotations, fix.R_icrs_to_camera.astype(np.float32))
    angle = np.degrees(np.arccos(np.clip((turn - 1) / 2, -1, 1)))
    last = np.argsort(scores, kind="stable")[-1500:]
    angle, scores = np.maximum(angle, 0.02)[last], scores[last]
    axes = new_axes(300, "angle from the true orientation, degrees", "detections explained (soft count)", log="x")
    for near, colour, name in ((angle >= 1.5, GREY, "others"), (angle < 1.5, BLUE, "within 1.5 degrees")):
        axes.plot(
            angle[near], scores[near], "o", markersize=5.0, markeredgewidth=0.0, alpha=0.7, color=colour, label=name
        )
    save(
        axes,
        folder / "solver_hypotheses.svg",
        "Detections explained by each hypothesis against its angle from the truth",
    )


def verification(folder: Path, field) -> None:
    """The field: detections, and which of them the verified orientation explains."""
    fix = solve_field(CONDITION, field)
    named = np.zeros(len(field.uv), dtype=bool)
    named[fix.matches[:, 0]] = True
    rows = np.arange(500)
    size = np.sqrt(np.maximum(3, 7 + np.log10(field.flux[rows]) * 2))
    axes = new_axes(373, "u, px", "v, px")
    axes.set(xlim=(0, 1080), ylim=(720, 0))
    for kind, colour, marker, name in ((~named, RED, "x", "clutter"), (named, BLUE, "o", "identified")):
        for step in np.unique(np.round(size[kind[rows]], 1)):
            here = kind[rows] & (np.round(size, 1) == step)
            axes.plot(*field.uv[rows][here].T, marker, markersize=1.6 * step, markeredgewidth=1.0, color=colour)
        axes.plot([], [], marker, markersize=5.0, color=colour, label=name)
    save(axes, folder / "solver_verification.svg", "Detections of the field, identified and clutter")


def depth(folder: Path) -> None:
    """How much of the catalogue a frame shows, and the magnitude limit that is found."""
    condition = Condition("depth", v_max=5.6, noise_px=0.5, missing=0.2, false=0.2)
    field = make_field(condition, 3, 4)
    fix = solve_field(condition, field)
    catalog = load_catalog()
    stars = catalog.take(np.flatnonzero(catalog.v_mag < 6.6))
    uv = camera_of(condition).project(stars.vectors @ fix.R_icrs_to_camera.T)
    stars = stars.take(camera_of(condition).in_frame(np.nan_to_num(uv, nan=-1e6)))
    found = np.isin(stars.star_id, fix.matches[:, 1])
    edges = np.arange(2.0, 6.61, 0.2)
    parts = [found[(stars.v_mag >= a) & (stars.v_mag < a + 0.2)].mean() for a in edges[:-1]]
    axes = new_axes(260, "V, mag", "share of the catalogue's stars detected")
    axes.bar(edges[:-1] + 0.1, parts, 0.16, color=BLUE)
    axes.axvline(fix.limiting_mag, color=RED, label="limiting magnitude found")
    save(axes, folder / "solver_depth.svg", "Share of the catalogue's stars detected against magnitude")


def accuracy(folder: Path) -> None:
    """Median error and the Cramer-Rao bound against the depth of the frame."""
    stars, errors, bounds = [], [], []
    for v_max in (3.5, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0):
        one = measure(Condition("a", v_max=v_max, noise_px=0.5, exact_attitude=True), 40, 11)
        stars.append(float(np.median(one.n_detections)))
        errors.append(float(np.nanmedian(one.error_km)))
        bounds.append(float(np.median(one.bound_km)))
    axes = new_axes(300, "stars in the frame", "median error, km (0.5 px, exact attitude)", log="xy")
    axes.plot(stars, errors, "o-", color=BLUE, label="solver")
    axes.plot(stars, bounds, "s--", color=GREY, label="Cramér-Rao bound")
    save(axes, folder / "solver_accuracy.svg", "Median error and Cramér-Rao bound against the number of stars")


def orbit(folder: Path) -> None:
    """The full-heading orbit: a mount tilted by 0.06 deg; single fixes, filter, smoother."""
    condition = Condition("orbit", v_max=5.0, noise_px=0.3, exact_attitude=True, tilt_deg=0.0)
    track, truth, singles = Track(celnav.TrackConfig(acceleration_km_s2=3e-5)), [], []
    bias = np.array([0.06, -0.03])
    rng = np.random.default_rng(5)
    for k in range(36):
        field = make_field(condition, 21, k)
        fix = solve_field(condition, field)
        heading = 10.0 * k
        s, c = math.sin(math.radians(heading)), math.cos(math.radians(heading))
        error = offset_km(fix.lat_deg, fix.lon_deg, field.lat_deg, field.lon_deg)
        place = moved(47.0, 8.0, 0.4 * k, 0.2 * k)
        seen = moved(*place, *(error + KM_PER_DEG * np.array([[s, c], [c, -s]]) @ bias + 0.02 * rng.normal(size=2)))
        shifted = celnav.Fix(True, celnav.Reason.OK, "", *seen, cov_km2=fix.cov_km2)
        track.update(shifted, f"2024-01-01T00:{k:02d}:00Z", heading)
        truth.append(place)
        singles.append(geodesic_km(*place, *seen))
    axes = new_axes(280, "frame (10 degrees of heading each)", "error, km", log="y")
    axes.plot(singles, linestyle=":", color=GREY, label="single fixes")
    for name, points, line, colour in (
        ("filter", track.points, "--", RED),
        ("smoother", track.smoothed(), "-", BLUE),
    ):
        errors = [geodesic_km(*truth[k], point.lat_deg, point.lon_deg) for k, point in enumerate(points)]
        axes.plot(errors, linestyle=line, color=colour, label=name)
    save(axes, folder / "solver_track.svg", "Error of single fixes, filter and smoother, frame by frame")


@house_style()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("docs/images"), help="folder to write")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    field = make_field(CONDITION, 7, 2)
    assert attitude_of(CONDITION, field).kind == "up"
    detection(folder)
    hypotheses(folder, field)
    verification(folder, field)
    depth(folder)
    accuracy(folder)
    orbit(folder)


if __name__ == "__main__":
    main()
