"""Production of twins: photographs are aligned, the weather is fitted, the twin is rendered and both are measured."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from benchmark.errors import PhotographError
from benchmark.photographed.alignment import align, directions
from benchmark.photographed.star_light import isolated, star_light
from benchmark.photographed.view import View, dark_plane, on_mask, view_of
from benchmark.twin.cloud_draw import SNR_IN_ORDER, choose_draw, cloud_of
from benchmark.twin.comparison import Stars, measure
from benchmark.twin.focus import fit_focus, focused_psf
from benchmark.twin.ground import masked_picture, widened
from benchmark.twin.photograph import Photograph
from benchmark.twin.scene import Scene, twin_scenario, twin_tree, with_passing, write_twin
from benchmark.twin.twin import Twin
from benchmark.twin.weather import (
    CLOUDED,
    CLOUDLESS,
    CLOUDS,
    DECK,
    DRAWS,
    LEAST_PX,
    VEIL,
    Fit,
    Seen,
    Weather,
    first_guess,
    fit_weather,
    sky_cells,
)
from celnav.camera import Camera
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import FramePlan, plan_frame
from generator.frame.record import star_table
from generator.frame.render import render_frame
from generator.frame.scene import ExpectedFrame
from generator.light.cloud_kinds import point_share
from generator.optics.wings import profile
from generator.scenario.file import Scenario
from generator.scenario.lens.stray_light_spec import BloomSpec
from generator.sky.clouds import CloudField

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE_PX = 4
"""Margin around the ground that is left out."""
SMALLER = 4
"""Factor by which the frames of the fit are smaller along each side."""
REST = ("zodiacal", "milky_way", "starlight", "moonlight", "twilight")
"""Components of the sky that the weather changes only through air and cloud."""
FIT_MAG, SEEN_SNR = 5.0, 3.0
"""Faintest star of the fit, and the SNR below which it counts as not seen."""
CLOUD_MAG, CLOUD_ABOVE_DEG, CLOUD_APERTURE_PX = 7.5, 20.0, 1.5
"""Faintest star used for cloud, the altitude above which such stars count, and the radius within which their light is
measured: with a radius of 3.5 px, six of ten lights above an SNR of 4 also appear next to the stars."""
BESIDE_PX, SEEN_OVER_CHANCE = 7.0, 2.0
"""Distance at which lights next to stars are counted, and the ratio of lights at stars to these from which stars count as
seen: it is 6.0 and 4.5 where gaps show some (001, 003), 1.1 where cloud hides all (012)."""
LEAST_LIGHT_DN = 3.0
"""Least light of the brightest cell of a sky that can be fitted."""
LOWEST_DEG, FOCUS_ABOVE_DEG = 8.0, 20.0
"""Altitudes from which stars are used, and from which they determine the focus."""


def make_twin(
    scene: Scene,
    photograph: Photograph,
    folder: Path,
    say: Callable[[str], None] = lambda _: None,
    not_sky: Mask | None = None,
    passing: Sequence[dict[str, Any]] = (),
) -> Twin:
    """Make the twin of a photograph and compare the two; its scenario and the files that it names are written to `folder`.

    Pixels of `not_sky` (height, width) are left out; those that are dark are ground in the twin of a scene without landscape.
    `passing` are trails that the twin also has; nothing is fitted to them.
    """
    camera, circle_px = scene.camera, scene.spec.camera.image_circle_px
    black_dn = float(scene.spec.sensor.black_level_dn)
    nominal = scene.spec.R_cam

    def scenario_of(R_cam: Floats, weather: Weather, change: dict[str, object] | None = None) -> Scenario:
        return twin_scenario(scene, twin_tree(scene, photograph, R_cam, weather) | (change or {}))

    say("aligning")
    first = render_frame(scenario_of(nominal, Weather()), 0, channels=False)
    rows = stars_of(first.stars)
    ground = ground_of(first.expected, photograph.pixels.shape)
    if not_sky is not None:
        ground |= not_sky
    view = view_of(camera, nominal)
    sky = _sky(view, ground, camera.cx_px, camera.cy_px, circle_px)
    bright = (rows["v_mag"] < FIT_MAG) & (rows["altitude_deg"] > LOWEST_DEG)
    enu = directions(rows["azimuth_deg"][bright], rows["altitude_deg"][bright])
    alignment = photograph.alignment or align(photograph.pixels, sky, camera, nominal, enu)
    view = view_of(camera, alignment.R_cam)

    say("fitting the weather")
    dark = dark_plane(photograph.pixels, camera, circle_px, black_dn)
    uv = camera.project(directions(rows["azimuth_deg"], rows["altitude_deg"]) @ alignment.R_cam.T)
    chosen = isolated(uv, rows["v_mag"]) & bright & on_mask(uv, sky)
    highest = 0.8 * (2**scene.spec.sensor.bits - 1)
    light = star_light(photograph.pixels, np.where(chosen[:, None], uv, np.nan), search_px=2.0)
    # A star behind cloud counts as if it were just visible, so that clouds are not judged by where their gaps are.
    least = light.flux_at(SEEN_SNR)
    known = np.isfinite(light.flux) & (light.peak < highest)
    real = Seen(sky_cells(photograph.pixels - dark, view, sky), np.where(known, np.maximum(light.flux, least), np.nan))
    sensor = scene.spec.sensor
    full = float(2**sensor.bits - 1)
    real = Seen(np.where(real.cells < 0.8 * full, real.cells, np.nan), real.stars)
    check_light(photograph.name, real.cells)
    skies = _Skies(scene, photograph, alignment.R_cam, rows, view, sky)
    # Behind cloud the brightest stars are too few to locate its gaps: use all that may be seen, including neighbours' light.
    many = (rows["v_mag"] < CLOUD_MAG) & (rows["altitude_deg"] > CLOUD_ABOVE_DEG) & on_mask(uv, sky)
    dimmed = star_light(photograph.pixels, np.where(many[:, None], uv, np.nan), aperture_px=CLOUD_APERTURE_PX)
    many &= dimmed.peak < highest
    unit = dimmed.noise * np.sqrt(np.pi) * CLOUD_APERTURE_PX
    # If no star is seen, the light at their positions is the texture of cloud.
    seen = stars_are_seen(photograph.pixels, uv[many])
    dimmed_snr = dimmed.flux / unit if seen else np.where(np.isfinite(dimmed.flux), 0.0, np.nan)
    scatter = np.random.default_rng(0).standard_normal(len(uv))

    def overcast(draw: int) -> CloudField:
        cloud = cloud_of(scenario_of(alignment.R_cam, Weather(cloud_tau=1.0, cloud_cover=1.0, cloud_draw=draw)))
        return dataclasses.replace(cloud, point_share=aperture_share(scene, cloud))

    @functools.cache
    def in_full(weather: Weather) -> NDArray[np.float32]:
        expected = render_expected(plan_frame(scenario_of(alignment.R_cam, weather), 0), False, False)
        return black_dn + np.asarray(expected.electrons, dtype=np.float32) / np.float32(sensor.gain_e_per_dn)

    def fit(names: tuple[str, ...], draws: Iterable[int] = ()) -> Fit:
        start = first_guess(names).cloudless
        dn = in_full(start)
        cells = sky_cells(dn - dark_plane(dn, camera, circle_px, black_dn), view, sky)
        stars = star_light(dn, np.where(np.isfinite(real.stars)[:, None], uv, np.nan)).flux
        reference = skies.seen(start)

        def shown(weather: Weather) -> Seen:
            now = skies.seen(weather)
            return Seen(cells * now.cells / reference.cells, np.maximum(stars * now.stars / reference.stars, least))

        known = np.where(np.isfinite(cells * reference.cells), real.cells, np.nan)
        if "cloud_cover" in names:
            undimmed = star_light(dn, np.where(many[:, None], uv, np.nan), aperture_px=CLOUD_APERTURE_PX)
            bright = undimmed.flux / unit
            told = many & np.isfinite(bright * reference.stars * dimmed_snr)
            enu = directions(rows["azimuth_deg"][told], rows["altitude_deg"][told])
            drawn = choose_draw(enu, dimmed_snr[told], bright[told], overcast, draws)
            before = Weather(cloud_tau=drawn.mean_depth, cloud_cover=drawn.cover, cloud_draw=drawn.draw)

            def shown_in_cloud(weather: Weather) -> Seen:
                now = skies.seen(weather)
                snr = bright * now.stars / reference.stars + scatter
                return Seen(cells * now.cells / reference.cells, np.maximum(snr, SNR_IN_ORDER))

            snr = np.where(told, np.maximum(dimmed_snr, SNR_IN_ORDER), np.nan)
            return fit_weather(Seen(known, snr), names, shown_in_cloud, before)
        return fit_weather(Seen(known, real.stars), names, shown, Weather())

    names = numbers_of(scene)
    fitted = fit(tuple(name for name in names if name in CLOUDLESS))
    if fitted.clouded:
        kind = CLOUDS.index(VEIL if seen else DECK)
        draws = range(kind * DRAWS, (kind + 1) * DRAWS)
        clouded = fit(tuple(name for name in names if name in CLOUDED), draws)
        fitted = min(fitted, clouded, key=lambda each: each.misfit)
    weather = fitted.weather
    if weather.cloud_tau is None:
        say("fitting the focus")

        def in_focus(factor: float) -> NDArray[np.float32]:
            change = {"camera": scene.tree["camera"] | focused_psf(scene.spec.camera, factor), "foreground": {}}
            stars_alone = change | {"sky": {"components": []}}
            plan = plan_frame(scenario_of(alignment.R_cam, weather, stars_alone), 0)
            return np.asarray(render_expected(plan, False, False).electrons, dtype=np.float32)

        named = chosen & on_mask(uv, view.altitude_deg > FOCUS_ABOVE_DEG)
        factor = (
            fit_focus(photograph.pixels, uv[named], highest, in_focus) if focused_psf(scene.spec.camera, 1.0) else None
        )
        weather = dataclasses.replace(weather, focus_factor=factor)
    say("rendering")
    tree = twin_tree(scene, photograph, alignment.R_cam, weather)
    if weather.focus_factor is not None:
        tree["camera"] = tree["camera"] | focused_psf(scene.spec.camera, weather.focus_factor)
    tree = with_passing(tree, passing)
    hidden = None
    if not_sky is not None and not scene.landscape:
        hidden = masked_picture(photograph.pixels, black_dn, not_sky, camera, alignment.R_cam)
    path, scenario = write_twin(scene, tree, folder, hidden)
    frame = render_frame(scenario, 0, channels=False)
    stars = stars_to_compare(frame.stars, camera)
    compared = sky & ~widened(ground_of(frame.expected, photograph.pixels.shape), EDGE_PX)
    measured = [
        measure(image, dark_plane(image, camera, circle_px, black_dn), view, compared, stars, full)
        for image in (photograph.pixels, frame.dn.astype(np.float32))
    ]
    return Twin(
        photograph=photograph,
        path=path,
        alignment=alignment,
        weather=weather,
        frame=frame,
        sky=compared,
        real=measured[0],
        made=measured[1],
        moon_altitude_deg=frame.plan.sky.moon_altitude_deg,
        sun_altitude_deg=frame.plan.sky.sun_altitude_deg,
    )


class _Skies:
    """Small twins by weather: light of the sky in cells, and electrons of stars."""

    def __init__(
        self,
        scene: Scene,
        photograph: Photograph,
        R_cam: Floats,
        rows: dict[str, Floats],
        view: View,
        sky: NDArray[np.bool_],
    ) -> None:
        self._scene, self._photograph, self._R_cam, self._ids = scene, photograph, R_cam, rows["star_id"]
        self._enu = directions(rows["azimuth_deg"], rows["altitude_deg"])
        self._camera = small_camera(scene)
        middle = slice(SMALLER // 2 - 1, None, SMALLER)
        height, width = scene.spec.camera.height // SMALLER, scene.spec.camera.width // SMALLER
        self._view = View(
            view.altitude_deg[middle, middle][:height, :width], view.azimuth_deg[middle, middle][:height, :width]
        )
        self._sky = sky[middle, middle][:height, :width]
        self._parts = functools.cache(self._render_parts)
        self._cities = functools.cache(self._render_cities)

    def seen(self, weather: Weather) -> Seen:
        """What the small twin shows: electrons per pixel, and of stars."""
        (airglow, rest), electrons = self._parts(
            Weather(
                aerosol_tau_550=weather.aerosol_tau_550,
                cloud_tau=weather.cloud_tau,
                cloud_cover=weather.cloud_cover,
                cloud_draw=weather.cloud_draw,
            )
        )
        light = rest + (weather.airglow_factor or 1.0) * airglow
        if self._scene.cities:
            light = light + (weather.city_factor or 1.0) * self._cities()
        return Seen(sky_cells(light, self._view, self._sky, LEAST_PX // SMALLER**2), electrons)

    def _render(self, weather: Weather, components: tuple[str, ...]) -> tuple[FramePlan, ExpectedFrame]:
        tree = twin_tree(self._scene, self._photograph, self._R_cam, weather)
        tree |= {"foreground": {}, "camera": self._camera, "sky": tree["sky"] | {"components": list(components)}}
        tree |= {"stars": listed_stars(tree.get("stars") or {})}
        if "clouds" in tree["sky"]:
            tree["sky"]["clouds"] = tree["sky"]["clouds"] | {"star_aureoles": False}
        plan = plan_frame(twin_scenario(self._scene, tree), 0)
        return plan, render_expected(plan, False, False)

    def _render_cities(self) -> NDArray[np.float32]:
        """Light of cities through the air of the first guess: its pattern hardly changes, and it takes longest to render."""
        _, expected = self._render(first_guess(CLOUDLESS), ("skyglow",))
        return np.asarray(expected.sky_electrons, dtype=np.float32)

    def _render_parts(self, air: Weather) -> tuple[list[NDArray[np.float32]], Floats]:
        """Light of airglow and of the rest of a sky without cities, and the stars' electrons."""
        _, glowing = self._render(air, ("airglow",))
        plan, others = self._render(air, REST)
        table = star_table(plan, others)
        by_id = dict(zip(table["star_id"].to_pylist(), table["electrons_e"].to_pylist(), strict=True))
        electrons = np.array([by_id.get(int(star), np.nan) for star in self._ids])
        clouds = plan.sky.clouds
        if clouds is not None:
            # Light within the apertures includes a part of what cloud diffracts.
            share = aperture_share(self._scene, clouds)
            passed = dataclasses.replace(clouds, point_share=share).point_transmission(self._enu)
            electrons = electrons * passed / np.maximum(clouds.point_transmission(self._enu), 1e-300)
        return [np.asarray(each.sky_electrons, dtype=np.float32) for each in (glowing, others)], electrons


def stars_are_seen(pixels: NDArray[np.floating], uv: Floats) -> bool:
    """Whether lights above an SNR of 5 are more frequent at the positions of stars (n, 2) than next to them."""

    def lights(places: Floats) -> int:
        light = star_light(pixels, places, aperture_px=CLOUD_APERTURE_PX)
        return int((light.flux > SNR_IN_ORDER * light.noise * np.sqrt(np.pi) * CLOUD_APERTURE_PX).sum())

    beside = sum(lights(uv + BESIDE_PX * np.array(way)) for way in ((1, 0), (0, 1), (-1, 0), (0, -1))) / 4
    return lights(uv) > SEEN_OVER_CHANCE * max(beside, 1.0)


def aperture_share(scene: Scene, cloud: CloudField) -> float:
    """Fraction of a cloud's depth that removes light from the apertures in which stars are measured for cloud."""
    return point_share(cloud.particle_um, CLOUD_APERTURE_PX / scene.spec.camera.projection.f_px)


def check_light(name: str, cells: Floats) -> None:
    """Refuse a photograph with no cell of the sky that has light above the dark level, in DN. Raises PhotographError."""
    if not np.nanmax(cells, initial=-np.inf) >= LEAST_LIGHT_DN:
        raise PhotographError(
            f"{name}: no part of its sky is brighter than the dark level and darker than full pixels; "
            "is it of this scene's camera, and of the night?"
        )


def listed_stars(stars: dict[str, object]) -> dict[str, object]:
    """Stars of a scene without those that its truth does not list."""
    listed = stars.get("listed_magnitude")
    return stars if listed is None else stars | {"limiting_magnitude": listed}


def small_camera(scene: Scene) -> dict[str, object]:
    """The scene's camera with pixels of four times the side, on which stars need no shape, under a clean dome."""
    given = dict(scene.tree["camera"])
    spec = scene.spec.camera
    for key in ("hfov_deg", "focal_length_mm", "psf", "dust"):
        given.pop(key, None)
    projection = spec.projection
    return given | {
        "width": spec.width // SMALLER,
        "height": spec.height // SMALLER,
        "f_px": projection.f_px / SMALLER,
        "cx_px": (projection.cx_px - 1) / SMALLER,
        "cy_px": (projection.cy_px - 1) / SMALLER,
        "psf": {"gaussian_sigma_px": 0.7},
        "bloom": small_wings(spec.bloom),
        "image_circle_px": None if spec.image_circle_px is None else spec.image_circle_px / SMALLER,
    }


def small_wings(bloom: BloomSpec) -> dict[str, float]:
    """Wings on the larger pixels, equally bright far from their source even where the core is below a scenario's minimum."""
    small = {
        "core_px": max(bloom.core_px / SMALLER, 0.5),
        "slope": bloom.slope,
        "reach_px": max(bloom.reach_px // SMALLER, 2),
    }
    middle = np.array([bloom.reach_px / 4])
    bright = bloom.share * SMALLER**2 * profile(bloom, middle)[0]
    return small | {"share": float(bright / profile(BloomSpec.model_validate(small), middle / SMALLER)[0])}


def numbers_of(scene: Scene) -> tuple[str, ...]:
    """Names of the weather's numbers that a scene leaves open; those of cities only where it has some."""
    names = tuple(
        field.name for field in dataclasses.fields(Weather) if field.name not in ("focus_factor", "cloud_draw")
    )
    return names if scene.cities else tuple(name for name in names if name != "city_factor")


def stars_of(table: pa.Table) -> dict[str, Floats]:
    """Columns of the stars in a frame's truth, without planets."""
    star = np.asarray(table["kind"].to_pylist()) == "star"
    names = ("star_id", "u_px", "v_px", "v_mag", "azimuth_deg", "altitude_deg")
    return {name: np.asarray(table[name], dtype=np.float64)[star] for name in names}


def stars_to_compare(table: pa.Table, camera: Camera) -> Stars:
    """Stars of the frame's truth, for the comparison."""
    rows = stars_of(table)
    uv = np.column_stack((rows["u_px"], rows["v_px"]))
    off_axis_deg = np.degrees(np.arccos(np.clip(camera.to_rays(uv)[:, 2], -1.0, 1.0)))
    return Stars(uv, rows["v_mag"], rows["altitude_deg"], off_axis_deg)


def ground_of(expected: ExpectedFrame, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Find the pixels that something in front of the sky covers."""
    return np.zeros(shape, dtype=bool) if expected.cover is None else np.asarray(expected.cover > 0.02)


def _sky(
    view: View, ground: NDArray[np.bool_], cx_px: float, cy_px: float, circle_px: float | None
) -> NDArray[np.bool_]:
    """Pixels above the horizon, within the image circle and away from the ground."""
    sky = np.nan_to_num(view.altitude_deg, nan=-90.0) > 0
    if circle_px is not None:
        height, width = sky.shape
        v, u = np.mgrid[0:height, 0:width]
        sky &= np.hypot(u - cx_px, v - cy_px) < circle_px - EDGE_PX
    return np.asarray(sky & ~widened(ground, EDGE_PX))
