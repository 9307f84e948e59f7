"""Twins of meteor cameras' stacks: sky, gain and black level are fitted, then the video is rendered."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import PhotographError
from benchmark.photographed.alignment import align, directions
from benchmark.photographed.star_light import isolated, star_light
from benchmark.photographed.view import on_mask, view_of
from benchmark.twin.comparison import measure
from benchmark.twin.ground import DARK_PART, masked_picture
from benchmark.twin.photograph import Photograph
from benchmark.twin.render_twin import FIT_MAG, ground_of, stars_of, stars_to_compare
from benchmark.twin.scene import Scene, twin_scenario, twin_tree, with_passing, write_twin
from benchmark.twin.stacked_video import StackedVideo, read_stack
from benchmark.twin.twin import StackRange, Twin, VideoWeather
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.frame.record import star_table
from generator.frame.render import render_frame
from generator.frame.video.take import STACK_SUFFIX
from generator.scenario.file import Scenario
from generator.sky.zenith import BORTLE_ZENITH_MAG

Floats = NDArray[np.float64]

ROUNDS = 3
"""Rounds of the fit; few suffice, because light is nearly proportional to the two numbers."""
STARTING_MAG = 20.5
BRIGHTEST_MAG, DARKEST_MAG = 16.5, 22.5
LEAST_STARS = 8
HIGHEST_8_BIT = 255.0
QUANTILES = (0.1, 0.5, 0.9)
DARK_SHARE, LEAST_DARK_PX = 0.01, 500
"""Fraction of a mask's pixels, the darkest, that determine the black level, and the fewest pixels that do."""
LEAST_CHANGE_8_BIT = 3.0
"""Least change of the black level; smaller ones are uncertain, because the light of the ground is from other pictures."""


def make_video_twin(
    scene: Scene,
    photograph: Photograph,
    folder: Path,
    say: Callable[[str], None] = lambda _: None,
    not_sky: NDArray[np.bool_] | None = None,
    passing: Sequence[dict[str, Any]] = (),
) -> Twin:
    """Make the twin of a stack of video and compare the two; its scenario is written to `folder`.

    `passing` are trails that the twin also has; nothing is fitted to them.
    """
    video, sensor, camera = scene.spec.sensor.video, scene.spec.sensor, scene.camera
    to_8_bit = stack_dn(scene, photograph.name)
    assert video is not None
    if not photograph.mean_of_video:
        raise PhotographError(f"{photograph.name}: is no stack of video, and the scene's sensor makes such")
    frames = video.count(scene.spec.time.exposure_s)
    if video.gamma != 1:
        raise PhotographError(
            f"{scene.path}: sensor.video.gamma is {video.gamma:g}; twins of stacks need a linear camera (1)"
        )
    weather = VideoWeather(_zenith_of(scene), 1.0, sensor.black_level_dn, sensor.gain_e_per_dn)

    def scenario_of(R_cam: Floats) -> Scenario:
        return twin_scenario(scene, twin_tree(scene, photograph, R_cam, weather))

    def expected_dn(R_cam: Floats) -> tuple[NDArray[np.float32], dict[str, Floats], NDArray[np.bool_]]:
        """Grey values of the mean frame without noise, its stars, and the mask of what hides the sky."""
        plan = plan_frame(scenario_of(R_cam), 0)
        expected = render_expected(plan, False, False)
        electrons = expected.electrons / frames + sensor.dark_current_e_s / video.frames_per_s
        dn = to_8_bit * (weather.black_level_dn + electrons * (weather.gain_factor / sensor.gain_e_per_dn))
        return dn.astype(np.float32), stars_of(star_table(plan, expected)), ground_of(expected, photograph.pixels.shape)

    say("aligning")
    _, rows, ground = expected_dn(scene.spec.R_cam)
    sky = ~ground if not_sky is None else ~(ground | not_sky)
    bright = rows["v_mag"] < FIT_MAG
    alignment = photograph.alignment or align(
        photograph.pixels, sky, camera, scene.spec.R_cam,
        directions(rows["azimuth_deg"][bright], rows["altitude_deg"][bright]),
    )  # fmt: skip
    view = view_of(camera, alignment.R_cam)
    sky &= np.nan_to_num(view.altitude_deg, nan=-90.0) > 0

    say("fitting")
    height, width = photograph.pixels.shape
    middle = np.zeros_like(sky)
    middle[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3] = True
    weather = dataclasses.replace(
        weather, black_level_dn=black_level(photograph.pixels, sky, not_sky, sensor.black_level_dn, to_8_bit)
    )
    black_dn = weather.black_level_dn * to_8_bit
    for _ in range(ROUNDS):
        dn, rows, _ = expected_dn(alignment.R_cam)
        uv = np.column_stack((rows["u_px"], rows["v_px"]))
        chosen = isolated(uv, rows["v_mag"]) & (rows["v_mag"] < FIT_MAG) & on_mask(uv, sky)
        places = np.where(chosen[:, None], uv, np.nan)
        ours, theirs = star_light(dn, places), star_light(photograph.pixels, places, search_px=2.0)
        seen = (theirs.snr > 5) & (theirs.peak < 0.8 * HIGHEST_8_BIT) & (ours.flux > 0)
        gain = float(np.median(theirs.flux[seen] / ours.flux[seen])) if seen.sum() >= LEAST_STARS else 1.0
        # The mean of a stack is rounded down.
        real = float(np.median(photograph.pixels[middle & sky])) + 0.5 - black_dn
        made = (float(np.median(dn[middle & sky])) - black_dn) * gain
        zenith = weather.zenith_mag_arcsec2 - 2.5 * float(np.log10(max(real, 0.1) / max(made, 1e-3)))
        weather = dataclasses.replace(
            weather,
            gain_factor=weather.gain_factor * gain,
            zenith_mag_arcsec2=float(np.clip(zenith, BRIGHTEST_MAG, DARKEST_MAG)),
        )

    say("rendering")
    tree = with_passing(twin_tree(scene, photograph, alignment.R_cam, weather), passing)
    hidden = None
    if not_sky is not None and not scene.landscape:
        hidden = masked_picture(photograph.pixels, black_dn, not_sky, camera, alignment.R_cam)
    path, scenario = write_twin(scene, tree, folder, hidden)
    frame = render_frame(scenario, 0, channels=False)
    stack, made_stack = photograph.stack, read_stack(frame.attached[STACK_SUFFIX], path.name)
    stars = stars_to_compare(frame.stars, camera)
    black = np.full((height, width), black_dn, dtype=np.float32)
    measured = [
        measure(image, black, view, sky, stars, HIGHEST_8_BIT) for image in (photograph.pixels, made_stack.mean)
    ]
    return Twin(
        photograph=photograph,
        path=path,
        alignment=alignment,
        weather=weather,
        frame=frame,
        sky=sky,
        real=measured[0],
        made=measured[1],
        moon_altitude_deg=frame.plan.sky.moon_altitude_deg,
        sun_altitude_deg=frame.plan.sky.sun_altitude_deg,
        ranges=None if stack is None else (range_of(stack, sky), range_of(made_stack, sky)),
    )


def stack_dn(scene: Scene, name: str) -> float:
    """Grey values of a stack per DN of the scene's sensor.

    Raises
    ------
    PhotographError
        The scene's sensor makes no video; the message begins with the photograph's name.
    """
    sensor = scene.spec.sensor
    if sensor.video is None:
        raise PhotographError(f"{name}: a stack of video needs a scene whose sensor makes video, such as meteor")
    return float(HIGHEST_8_BIT / (2**sensor.bits - 1) * sensor.video.exposure)


def black_level(
    pixels: NDArray[np.floating],
    sky: NDArray[np.bool_],
    not_sky: NDArray[np.bool_] | None,
    usual_dn: int,
    to_8_bit: float,
) -> int:
    """DN of the sensor without light, from pixels hidden by a mask: dark ground reflects `DARK_PART` of the sky's light.

    It is the scene's own level, `usual_dn`, if the mask has fewer than `LEAST_DARK_PX` pixels or if the result differs by
    less than `LEAST_CHANGE_8_BIT`. An operator's brightness setting adds the same amount to all pixels.
    """
    if not_sky is None or not_sky.sum() < LEAST_DARK_PX or not sky.any():
        return usual_dn
    # The mean of a stack is rounded down.
    ground = float(np.quantile(pixels[not_sky], DARK_SHARE)) + 0.5
    black = (ground - DARK_PART * (float(np.median(pixels[sky])) + 0.5)) / (1 - DARK_PART)
    return usual_dn if abs(black - usual_dn * to_8_bit) < LEAST_CHANGE_8_BIT else max(0, round(black / to_8_bit))


def range_of(stack: StackedVideo, sky: NDArray[np.bool_]) -> StackRange:
    """Quantiles of a stack's pictures over the sky."""
    return StackRange(
        np.quantile(stack.deviation[sky], QUANTILES), np.quantile((stack.maximum - stack.mean)[sky], QUANTILES)
    )


def _zenith_of(scene: Scene) -> float:
    """Brightness of the zenith with which the fit starts."""
    sky = scene.spec.sky
    if sky.bortle is not None:
        return BORTLE_ZENITH_MAG[sky.bortle]
    return STARTING_MAG if sky.zenith_mag_arcsec2 is None else sky.zenith_mag_arcsec2
