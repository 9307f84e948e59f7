"""One lens for all frames: each frame is brought in, stars are matched again with the joint lens, and noise is measured."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.below_horizon import HIGHEST_DEG, stars_below
from celnav.calibrating.blind_start import PASSES, Start, find_start, identify_with, is_mirrored, is_narrow
from celnav.calibrating.bundle import Bundle, Observations, adjust, residuals
from celnav.calibrating.fixed_detections import moving
from celnav.calibrating.frames import DEEP_MAG, CalibrationFrame, Sky, sky_over
from celnav.calibrating.growth import FEWEST, GENERAL, grow, held, observations
from celnav.calibrating.scatter.noise import CLIP_SIGMAS, Noise, measure_noise
from celnav.calibrating.scatter.pixel_phase import PixelPhase, measure_pixel_phase
from celnav.calibrating.star_matching import Match, match_frame
from celnav.camera import Camera
from celnav.errors import CalibrationError

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

# A frame is of the same mount when chance gives as many stars with a probability below this.
MOST_LOG10_CHANCE = -8.0
_MOUNT_RADII_PX = (10.0, 5.0, 3.0)
# Magnitudes, and how many stars of the frame there have to be at least.
_MOUNT_DEPTHS = ((3.5, 12), (4.5, 30), (5.5, 80))
_FIRST_RADIUS_PX = 3.0
# Frames that a guess is tried on: 0.04 s each.
_GUESSED_FRAMES = 50
_LEAST_RADIUS_PX, _MOST_RADIUS_PX = 0.8, 4.0
_ROUNDS = 4
# Of the stars of a frame: more of them below the horizon contradict place or time.
_MOST_BELOW = 0.05


class NothingNamedError(CalibrationError):
    """No star of any frame can be named."""


@dataclass(frozen=True, eq=False)
class Field:
    """Frames with the stars over them.

    Attributes
    ----------
    frames, skies : list
        Of equal length.
    usable : list of ndarray of bool
        Detections of each frame that may be stars.
    """

    frames: list[CalibrationFrame]
    skies: list[Sky]
    usable: list[NDArray[np.bool_]]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of all frames."""
        return self.frames[0].size

    def take(self, numbers: list[int]) -> Field:
        """Return the field of the chosen frames."""
        return Field(
            [self.frames[i] for i in numbers], [self.skies[i] for i in numbers], [self.usable[i] for i in numbers]
        )

    def as_deep_as(self, camera: Camera) -> Field:
        """Return the field with as many stars as a camera needs: narrow fields show few of the brighter ones."""
        if not is_narrow(camera):
            return self
        return replace(self, skies=[sky_over(sky.site, sky.utc, DEEP_MAG) for sky in self.skies])


@dataclass(frozen=True, eq=False)
class JointFit:
    """The lens with an attitude for each group of frames, and the stars that it was fitted to.

    Attributes
    ----------
    bundle : Bundle
        Lens and attitudes, with their covariance.
    group : ndarray, shape (number of frames,)
        The attitude of each frame.
    seen : Observations
        Stars that were taken for true, with the standard deviations that the fit gave them; their positions are without
        pixel-phase error.
    matches : list of Match
        All pairs of each frame, those that were left out for their distance included.
    noise : Noise
        Scatter of the positions.
    phase : PixelPhase
        What was taken off the measured positions.
    """

    bundle: Bundle
    group: Rows
    seen: Observations
    matches: list[Match]
    noise: Noise
    phase: PixelPhase

    @property
    def residual_px(self) -> F8:
        """Measured minus predicted, shape (n, 2)."""
        return residuals(self.bundle, self.seen, self.group[self.seen.frame])


def first_frame(field: Field, guess: Start | None = None) -> tuple[int, Bundle]:
    """Find lens and attitude from the first frame whose middle shows stars that can be named.

    `guess` is a camera whose focal length is known within 6 %.
    """
    for i, start in _starts(field, guess):
        part = field.take([i]).as_deep_as(start.camera)
        frame, sky = part.frames[0], part.skies[0]
        if float((start.rotation.T @ middle_axis(start))[2]) < math.sin(math.radians(-20)):
            raise CalibrationError(
                f"frame {frame.name}: {start.stars} stars are identified, but they lie below the horizon of the place at "
                "that time: check latitude, longitude (east is positive) and time"
            )
        bundle = grow(frame, sky, start)
        if _bound(part, 0, bundle, math.inf) < MOST_LOG10_CHANCE:
            _refuse_below_horizon(frame, sky, start)
            return i, bundle
    if is_mirrored(field.frames[0], field.skies[0]):
        raise CalibrationError("the frames show the sky mirrored: turn the rows of the images over")
    raise NothingNamedError(
        "no frame shows stars that could be named in its middle: give a clearer frame, longer exposures or a camera"
    )


def _refuse_below_horizon(frame: CalibrationFrame, sky: Sky, start: Start) -> None:
    """Raise where a frame, its lens fitted to the stars of the whole sky, shows stars below the horizon of the place."""
    if is_narrow(start.camera):  # the middle has told
        return
    whole = sky_over(sky.site, sky.utc, lowest_deg=-90.0)
    bundle = grow(frame, whole, start)
    predicted = bundle.predict(whole.dirs, np.zeros(len(whole.dirs), dtype=np.intp))
    match = match_frame(frame, whole, predicted, 3.0)
    seen, chance = stars_below(frame, whole, bundle, match.limiting_mag)
    if seen > _MOST_BELOW * len(match.star) and chance < MOST_LOG10_CHANCE:
        raise CalibrationError(
            f"frame {frame.name}: {seen} stars are seen that stand more than {-HIGHEST_DEG:g} deg below the horizon of the "
            "place at that time: check latitude, longitude (east is positive) and time"
        )


def _starts(field: Field, guess: Start | None) -> Iterator[tuple[int, Start]]:
    """Frames whose middle can be named, with their starts: by the guess, then by the passes of a blind search."""
    if guess is not None:
        for i, (frame, sky) in enumerate(zip(field.frames, field.skies, strict=True)):
            if i < _GUESSED_FRAMES and (start := identify_with(frame, sky, guess.camera, guess.reach_px)) is not None:
                yield i, start
    for each in PASSES:
        count = len(field.frames)
        for i in np.unique(np.linspace(0, count - 1, min(count, each.frames)).round().astype(int)).tolist():
            if (start := find_start(field.frames[i], field.skies[i], (each,))) is not None:
                yield i, start


def middle_axis(start: Start) -> F8:
    """Direction of the middle of the frame in the camera's axes."""
    camera = start.camera
    return np.asarray(camera.to_rays([[(camera.width - 1) / 2, (camera.height - 1) / 2]])[0])


def _bound(field: Field, number: int, bundle: Bundle, faintest_mag: float) -> float:
    sky = field.skies[number]
    predicted = bundle.predict(sky.dirs, np.zeros(len(sky.dirs), dtype=np.intp))
    return match_frame(field.frames[number], sky, predicted, 3.0, faintest_mag=faintest_mag).log10_chance


def attitude_of(field: Field, number: int, lens: Bundle, near: list[F8]) -> F8 | None:
    """Find the attitude of a frame with a lens that is known: near those of other frames, or from nothing; None: neither."""
    frame, sky, usable = field.frames[number], field.skies[number], field.usable[number]
    none = np.zeros(len(sky.dirs), dtype=np.intp)
    infinite = np.full(len(lens.values), 1e18)
    best: tuple[float, F8] | None = None
    for rotation in near:
        bundle = replace(lens, rotations=rotation[None], cov=None)
        match = None
        for radius, (v_mag, stars) in zip(_MOUNT_RADII_PX, _MOUNT_DEPTHS, strict=True):
            predicted = bundle.predict(sky.dirs, none)
            faintest = max(v_mag, sky.magnitude_of(predicted, frame.size, stars))
            match = match_frame(frame, sky, predicted, radius, faintest_mag=faintest, usable=usable)
            if len(match.detection) < 6:
                break
            seen = observations([frame], [sky], [match])
            bundle = adjust(bundle, seen, seen.frame, robust=True, prior=infinite)
        if match is not None and (best is None or match.log10_chance < best[0]):
            best = match.log10_chance, bundle.rotations[0]
        if best is not None and best[0] < 3 * MOST_LOG10_CHANCE:
            return best[1]
    if best is not None and best[0] < MOST_LOG10_CHANCE:
        return best[1]
    camera = lens.form.camera(lens.values, lens.size)
    start = identify_with(frame, sky, camera, math.hypot(*frame.size))
    if start is None or abs(math.log(start.camera.f_px / camera.f_px)) > 0.02:
        return None
    return start.rotation


def fit_all(field: Field, guess: Start | None = None) -> tuple[list[int], Field, JointFit]:
    """Fit one general lens to all frames, an attitude to each.

    Returns
    -------
    Numbers of the frames that could be used, the field of these frames, and the fit.
    """
    number, lens = first_frame(field, guess)
    field = field.as_deep_as(lens.form.camera(lens.values, lens.size))
    attitudes: dict[int, F8] = {number: lens.rotations[0]}
    # Frames next in time first: their attitudes are the most alike.
    order = sorted(range(len(field.frames)), key=lambda i: abs(field.frames[i].utc.mjd - field.frames[number].utc.mjd))
    for i in order:
        if i in attitudes:
            continue
        near = [
            attitudes[j]
            for j in sorted(attitudes, key=lambda j: abs(field.frames[j].utc.mjd - field.frames[i].utc.mjd))
        ]
        found = attitude_of(field, i, lens, near[:2])
        if found is not None:
            attitudes[i] = found
    used = sorted(attitudes)
    part = field.take(used)
    bundle = replace(lens, rotations=np.stack([attitudes[i] for i in used]), cov=None)
    group = np.arange(len(used))
    form = replace(GENERAL, decentring=True)
    bundle = replace(bundle, form=form, values=np.append(bundle.values, [0.0, 0.0]))
    return used, part, refine(part, bundle, group, held_back=True)


def refine(field: Field, bundle: Bundle, group: Rows, *, held_back: bool = False, rounds: int = _ROUNDS) -> JointFit:
    """Match all frames with the bundle, adjust, measure the noise, and repeat.

    Parameters
    ----------
    field, bundle, group
        Frames; lens and attitudes to start from; the attitude of each frame.
    held_back : bool
        Hold the lens to the weak expectations of `growth.held`, for frames that may not determine it.
    rounds : int
        Of matching.
    """
    prior = held(bundle.form, bundle) if held_back else None
    usable, radius = field.usable, _FIRST_RADIUS_PX
    noise = Noise(1.0, 0.0)
    for round_ in range(rounds):
        matches = [
            match_frame(frame, sky, bundle.predict(sky.dirs, np.full(len(sky.dirs), g)), radius, usable=good)
            for frame, sky, g, good in zip(field.frames, field.skies, group, usable, strict=True)
        ]
        pairs = observations(field.frames, field.skies, matches)
        if len(pairs) < FEWEST:
            raise CalibrationError(f"{len(pairs)} stars are too few for a calibration: {FEWEST} are needed")
        own = centroid_sigma(field, pairs)
        pairs = replace(pairs, sigma_px=noise.sigma_px(own, pairs.pull_px))
        bundle = adjust(bundle, pairs, group[pairs.frame], robust=True, prior=prior)
        bundle, seen, noise, phase = settle(bundle, pairs, own, group, prior)
        radius = float(np.clip(6 * np.median(seen.sigma_px), _LEAST_RADIUS_PX, _MOST_RADIUS_PX))
        if round_ == 0:
            still = moving(field.frames, bundle.values[0])
            usable = [good & alive for good, alive in zip(usable, still, strict=True)]
    return JointFit(bundle, group, seen, matches, noise, phase)


def settle(
    bundle: Bundle, pairs: Observations, own: F8, group: Rows, prior: F8 | None = None
) -> tuple[Bundle, Observations, Noise, PixelPhase]:
    """Measure noise and pixel-phase error, take the stars within 4 standard deviations, adjust by squares; three times.

    Lens and pixel-phase error are all but uncorrelated, one varying over the frame and one within a pixel.
    """
    phase = PixelPhase()
    for _ in range(3):
        left = residuals(bundle, pairs, group[pairs.frame])
        residual = left - phase.error_px(pairs.uv)
        square = np.nan_to_num(np.einsum("ni,ni->n", residual, residual), nan=np.inf)
        noise = measure_noise(square, own, pairs.pull_px)
        sigma = noise.sigma_px(own, pairs.pull_px)
        near = square <= (CLIP_SIGMAS * sigma) ** 2
        kept = replace(pairs, sigma_px=sigma).take(near)
        phase = measure_pixel_phase(kept.uv, left[near], kept.sigma_px)
        kept = replace(kept, uv=kept.uv - phase.error_px(kept.uv))
        bundle = adjust(bundle, kept, group[kept.frame], robust=False, prior=prior)
    return bundle, kept, noise, phase


def centroid_sigma(field: Field, pairs: Observations) -> F8:
    """Return the standard deviations that detection gave the positions, shape (n,); 0 where it gave none."""
    sigma = np.zeros(len(pairs))
    for i, frame in enumerate(field.frames):
        rows = pairs.frame == i
        if frame.detections.sigma_px is not None:
            sigma[rows] = frame.detections.sigma_px[pairs.detection[rows]]
    return sigma
