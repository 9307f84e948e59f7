"""``skybench gallery``: all pictures of docs/gallery."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from generator.gallery.camera_views import cameras
from generator.gallery.fisheye import View, all_sky, plan_of
from generator.gallery.landscape_views import landscapes
from generator.gallery.light_plots import artificial_and_moon
from generator.gallery.natural_plots import natural_sky
from generator.gallery.trail_views import star_trails
from generator.gallery.twilight_plots import twilight_measured
from generator.gallery.video_views import meteor_stack

AUTUMN_NIGHT = "2020-09-15T20:30:00Z"
JPEG = {"quality": 88}


def sheet(views: Sequence[tuple[str, View]], columns: int, path: Path, title: str) -> Path:
    """Write a sheet of all-sky views, each with its exposure."""
    rows = -(-len(views) // columns)
    figure = Figure(figsize=(3.1 * columns, 3.6 * rows + 0.5), facecolor="#1f1f1f")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, (name, view) in zip(axes.flat, views, strict=False):
        axis.imshow(view.rgb, interpolation="lanczos")
        axis.set_title(f"{name}\nwhite = {1000 * view.white_cd_m2:.3g} mcd/m²", color="white", fontsize=9)
    figure.suptitle(title + " (north up, east left)", color="white", fontsize=10)
    return save(figure, path)


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as JPEG."""
    figure.tight_layout(h_pad=2.0)
    figure.savefig(path, dpi=100, pil_kwargs=JPEG)
    return path


def make_gallery(folder: Path) -> list[Path]:
    """Write all pictures to `folder`; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    classes = [(f"Bortle {k}", all_sky(plan_of(f"{{bortle: {k}}}", AUTUMN_NIGHT))) for k in range(1, 10)]
    pictures = [sheet(classes, 3, folder / "bortle.jpg", "Bortle classes, the city in the south-west")]
    nights = {"New Moon": "2020-01-24T19:30:00Z", "30 %": "2020-01-29T18:30:00Z", "Half Moon": "2020-02-02T19:00:00Z",
              "Full Moon": "2020-02-09T21:30:00Z"}  # fmt: skip
    moons = [(name, all_sky(plan_of("{bortle: 2}", utc))) for name, utc in nights.items()]
    pictures.append(sheet(moons, 2, folder / "moon.jpg", "Moon phases over a dark place"))
    pictures.append(sheet(twilight_views(), 2, folder / "twilight.jpg", "Evening twilight over a dark place"))
    cloud = "clouds: {mean_optical_depth: 0.8, coverage: 0.6, altitude_km: 6}"
    skies = {"City, clear": "{bortle: 8}", "City, thin cloud": f"{{bortle: 8, {cloud}}}",
             "Desert, clear": "{bortle: 1}", "Desert, thin cloud": f"{{bortle: 1, {cloud}}}"}  # fmt: skip
    clear = {name: all_sky(plan_of(sky, AUTUMN_NIGHT)) for name, sky in skies.items() if "clear" in name}
    views = []
    for name, sky in skies.items():
        white = clear[f"{name.split(',')[0]}, clear"].white_cd_m2
        views.append((name, all_sky(plan_of(sky, AUTUMN_NIGHT), white_cd_m2=white)))
    pictures.append(sheet(views, 2, folder / "clouds.jpg", "The same thin cloud over a city and over a desert"))
    pictures.append(sheet(cloud_views(), 3, folder / "cloud_kinds.jpg", "Kinds of cloud over lamps and under the Moon"))
    pictures.append(save(landscapes(), folder / "landscapes.jpg"))
    pictures.append(save(star_trails(), folder / "star_trails.jpg"))
    pictures.append(save(meteor_stack(), folder / "meteor_stack.jpg"))
    pictures.append(save(natural_sky(), folder / "natural_sky.jpg"))
    pictures.append(save(artificial_and_moon(), folder / "city_and_moon.jpg"))
    pictures.append(save(twilight_measured(), folder / "twilight_measured.jpg"))
    pictures.append(save(cameras(), folder / "cameras.jpg"))
    return pictures


def cloud_views() -> list[tuple[str, View]]:
    """Kinds of cloud: lit by a suburb from below, in front of a dark sky, and lit by the Moon from above."""
    new_moon, high_moon = "2020-01-24T19:30:00Z", "2020-02-06T20:30:00Z"
    skies = [
        ("Suburb, cirrus", 6, "kind: cirrus, wind_azimuth_deg: 60", new_moon),
        ("Suburb, altocumulus", 6, "kind: altocumulus, wind_azimuth_deg: 60", new_moon),
        ("Suburb, stratocumulus", 6, "kind: stratocumulus, coverage: 0.6, wind_azimuth_deg: 60", new_moon),
        ("Dark place, cumulus", 2, "kind: cumulus", new_moon),
        ("Dark place, cirrus and Moon", 2, "kind: cirrus, wind_azimuth_deg: 60", high_moon),
        ("Dark place, stratocumulus and Moon", 2, "kind: stratocumulus, coverage: 0.6", high_moon),
    ]
    return [
        (name, all_sky(plan_of(f"{{bortle: {bortle}, clouds: {{{cloud}}}}}", utc)))
        for name, bortle, cloud, utc in skies
    ]


def twilight_views() -> list[tuple[str, View]]:
    """Views with the Sun 6, 9, 12 and 18 deg below the horizon, at times found by bisection of the evening."""
    views = []
    for depression in (6.0, 9.0, 12.0, 18.0):
        early, late = 17 * 60.0, 20 * 60.0
        for _ in range(14):
            minute = (early + late) / 2
            plan = plan_of("{components: [airglow]}", _clock(minute))
            early, late = (minute, late) if -plan.sky.sun_altitude_deg < depression else (early, minute)
        views.append((f"Sun {-depression:.0f}°", all_sky(plan_of("{bortle: 2}", _clock(early)))))
    return views


def _clock(minute: float) -> str:
    """UTC of a minute of 15 September 2020."""
    second = round(minute * 60)
    return f"2020-09-15T{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}Z"
