"""Figures of docs/solver.md, one per stage of the solver: python tools/solver_figures.py docs/images."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import altair as alt
import numpy as np
import pandas as pd
import vl_convert
from scipy.spatial import cKDTree

import celnav
from benchmark.fields.solver_bars import attitude_of, camera_of, measure, solve_field
from benchmark.fields.solver_fields import Condition, make_field
from benchmark.fields.solver_table import image_of
from benchmark.judge.geodesy import geodesic_km
from celnav.catalog import load_catalog
from celnav.identification import identify
from celnav.track import KM_PER_DEG, Track, moved, offset_km

CONDITION = Condition("figure", noise_px=0.5, missing=0.5, false=1.0)
BLUE, RED, GREY = "#2563a8", "#c4452f", "#9aa0a6"


def save(chart: alt.Chart | alt.LayerChart, path: Path) -> None:
    chart = chart.configure_view(stroke=None).configure_axis(grid=False, labelFontSize=12, titleFontSize=13)
    path.write_text(vl_convert.vegalite_to_svg(chart.to_json()), encoding="utf-8")
    print(path, path.stat().st_size)


def detection(folder: Path) -> None:
    """Share of the stars found over magnitude, by the matched filter and by flood fill, on the same images."""
    condition = Condition("detection", v_max=8.0)
    edges = np.arange(5.0, 8.01, 0.25)
    configs = {"matched filter": celnav.DetectionConfig(), "flood fill": celnav.FloodFillConfig()}
    found = {name: np.zeros(len(edges) - 1) for name in configs}
    total = np.zeros(len(edges) - 1)
    for number in range(4):
        field, image = make_field(condition, 13, number), image_of(condition, 13, number)
        v_mag = -2.5 * np.log10(field.flux)
        # Stars with another one within four pixels are left out.
        near = cKDTree(field.uv).query_pairs(4.0, output_type="ndarray")
        alone = np.ones(len(field.uv), dtype=bool)
        alone[near.ravel()] = False
        total += np.histogram(v_mag[alone], edges)[0]
        for name, config in configs.items():
            seen = cKDTree(celnav.detect(image, config=config).uv).query(field.uv)[0] < 1.5
            found[name] += np.histogram(v_mag[alone & seen], edges)[0]
    rows = [
        {"v": (a + b) / 2, "part": hits / n, "what": name}
        for name, counts in found.items()
        for a, b, hits, n in zip(edges[:-1], edges[1:], counts, total, strict=True)
    ]
    chart = (
        alt.Chart(pd.DataFrame(rows))
        .mark_line(point=True)
        .encode(
            x=alt.X("v:Q", title="V", scale=alt.Scale(zero=False)),
            y=alt.Y("part:Q", title="share of single stars found"),
            color=alt.Color("what:N", title=None, scale=alt.Scale(domain=list(configs), range=[BLUE, GREY])),
        )
        .properties(width=560, height=260)
    )
    save(chart, folder / "solver_detection.svg")


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
    # The chunk that held the right one; a look for a rival may have followed.
    rotations, scores = max(seen, key=lambda chunk: float(chunk[1].max(initial=0.0)))
    turn = np.einsum("hij,ji->h", rotations, fix.R_icrs_to_camera.astype(np.float32))
    angle = np.degrees(np.arccos(np.clip((turn - 1) / 2, -1, 1)))
    table = pd.DataFrame({"angle": np.maximum(angle, 0.02), "score": scores, "true": angle < 1.5})
    table = table.sort_values("score").iloc[-1500:]
    chart = (
        alt.Chart(table)
        .mark_circle(size=22, opacity=0.7)
        .encode(
            x=alt.X("angle:Q", title="angle from the true orientation, degrees", scale=alt.Scale(type="log")),
            y=alt.Y("score:Q", title="detections explained (soft count)"),
            color=alt.Color("true:N", scale=alt.Scale(domain=[True, False], range=[BLUE, GREY]), legend=None),
        )
        .properties(width=560, height=300)
    )
    save(chart, folder / "solver_hypotheses.svg")


def verification(folder: Path, field) -> None:
    """The field: detections, and which of them the verified orientation explains."""
    fix = solve_field(CONDITION, field)
    named = np.zeros(len(field.uv), dtype=bool)
    named[fix.matches[:, 0]] = True
    rows = np.arange(500)
    table = pd.DataFrame(
        {"u": field.uv[rows, 0], "v": field.uv[rows, 1],
         "what": np.where(named[rows], "named", "clutter"), "size": np.maximum(3, 7 + np.log10(field.flux[rows]) * 2)}
    )  # fmt: skip
    chart = (
        alt.Chart(table)
        .mark_circle()
        .encode(
            x=alt.X("u:Q", title="u, px", scale=alt.Scale(domain=[0, 1080])),
            y=alt.Y("v:Q", title="v, px", scale=alt.Scale(domain=[720, 0])),
            size=alt.Size("size:Q", legend=None, scale=alt.Scale(range=[6, 60])),
            color=alt.Color("what:N", title=None, scale=alt.Scale(domain=["named", "clutter"], range=[BLUE, RED])),
        )
        .properties(width=560, height=373)
    )
    save(chart, folder / "solver_verification.svg")


def depth(folder: Path) -> None:
    """How much of the catalogue a frame shows, and the limit that is found."""
    condition = Condition("depth", v_max=5.6, noise_px=0.5, missing=0.2, false=0.2)
    field = make_field(condition, 3, 4)
    fix = solve_field(condition, field)
    catalog = load_catalog()
    stars = catalog.take(np.flatnonzero(catalog.v_mag < 6.6))
    uv = camera_of(condition).project(stars.vectors @ fix.R_icrs_to_camera.T)
    stars = stars.take(camera_of(condition).in_frame(np.nan_to_num(uv, nan=-1e6)))
    found = np.isin(stars.star_id, fix.matches[:, 1])
    edges = np.arange(2.0, 6.61, 0.2)
    table = pd.DataFrame(
        {"v": edges[:-1] + 0.1,
         "part": [found[(stars.v_mag >= a) & (stars.v_mag < a + 0.2)].mean() for a in edges[:-1]]}
    )  # fmt: skip
    bars = alt.Chart(table).mark_bar(size=18, color=BLUE).encode(
        x=alt.X("v:Q", title="V"), y=alt.Y("part:Q", title="share of the catalogue's stars detected")
    )  # fmt: skip
    rule = alt.Chart(pd.DataFrame({"v": [fix.limiting_mag]})).mark_rule(color=RED, strokeWidth=2).encode(x="v:Q")
    save((bars + rule).properties(width=560, height=260), folder / "solver_depth.svg")


def accuracy(folder: Path) -> None:
    """Median error and the Cramer-Rao bound over the depth of the frame."""
    rows = []
    for v_max in (3.5, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0):
        one = measure(Condition("a", v_max=v_max, noise_px=0.5, exact_attitude=True), 40, 11)
        for name, value in (("solver", np.nanmedian(one.error_km)), ("Cramer-Rao bound", np.median(one.bound_km))):
            rows.append({"stars": float(np.median(one.n_detections)), "km": float(value), "what": name})
    chart = (
        alt.Chart(pd.DataFrame(rows))
        .mark_line(point=True)
        .encode(
            x=alt.X("stars:Q", title="stars in the frame", scale=alt.Scale(type="log")),
            y=alt.Y("km:Q", title="median error, km (0.5 px, exact attitude)", scale=alt.Scale(type="log")),
            color=alt.Color(
                "what:N", title=None, scale=alt.Scale(domain=["solver", "Cramer-Rao bound"], range=[BLUE, GREY])
            ),
        )
        .properties(width=560, height=300)
    )
    save(chart, folder / "solver_accuracy.svg")


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
    rows = []
    for name, points in (("filter", track.points), ("smoother", track.smoothed())):
        rows += [
            {"k": k, "km": geodesic_km(*truth[k], point.lat_deg, point.lon_deg), "what": name}
            for k, point in enumerate(points)
        ]
    rows += [{"k": k, "km": value, "what": "single fixes"} for k, value in enumerate(singles)]
    chart = (
        alt.Chart(pd.DataFrame(rows))
        .mark_line()
        .encode(
            x=alt.X("k:Q", title="frame (10 degrees of heading each)"),
            y=alt.Y("km:Q", title="error, km", scale=alt.Scale(type="log")),
            color=alt.Color(
                "what:N",
                title=None,
                scale=alt.Scale(domain=["single fixes", "filter", "smoother"], range=[GREY, RED, BLUE]),
            ),
        )
        .properties(width=560, height=280)
    )
    save(chart, folder / "solver_track.svg")


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
