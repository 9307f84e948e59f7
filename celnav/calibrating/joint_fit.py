"""Joint fit of one lens to all frames: stars are matched again with the joint lens, and the noise is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from celnav.calibrating.blind_start import is_narrow
from celnav.calibrating.bundle import Bundle, Observations, adjust, residuals
from celnav.calibrating.fixed_detections import moving
from celnav.calibrating.frames import DEEP_MAG, CalibrationFrame, Sky, sky_over
from celnav.calibrating.growth import FEWEST, held, observations
from celnav.calibrating.scatter.noise import CLIP_SIGMAS, Noise, measure_noise
from celnav.calibrating.scatter.pixel_phase import PixelPhase, measure_pixel_phase
from celnav.calibrating.star_matching import Match, match_frame
from celnav.camera import Camera
from celnav.errors import CalibrationError

F8 = NDArray[np.float64]
Rows = NDArray[np.intp]

# A frame is accepted as one of the same mount if the probability of as many stars by chance is below this.
MOST_LOG10_CHANCE = -8.0
_FIRST_RADIUS_PX = 3.0
_LEAST_RADIUS_PX, _MOST_RADIUS_PX = 0.8, 4.0
_ROUNDS = 4


class NothingNamedError(CalibrationError):
    """No star of any frame can be identified."""


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
        """Return the field of the selected frames."""
        return Field(
            [self.frames[i] for i in numbers], [self.skies[i] for i in numbers], [self.usable[i] for i in numbers]
        )

    def as_deep_as(self, camera: Camera) -> Field:
        """Return the field with stars as faint as a camera needs: narrow fields show few of the brighter ones."""
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
        Index of the attitude of each frame.
    seen : Observations
        Accepted stars, with the standard deviations from the fit; their positions are corrected for pixel-phase error.
    matches : list of Match
        All pairs of each frame, including those that were left out because of their distance.
    noise : Noise
        Scatter of the positions.
    phase : PixelPhase
        Pixel-phase error that was subtracted from the measured positions.
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


def refine(field: Field, bundle: Bundle, group: Rows, *, held_back: bool = False, rounds: int = _ROUNDS) -> JointFit:
    """Match all frames with the bundle, adjust, measure the noise, and repeat.

    Parameters
    ----------
    field, bundle, group
        Frames; lens and attitudes to start from; index of the attitude of each frame.
    held_back : bool
        Apply the weak priors of `growth.held` to the lens, for frames that may not determine it.
    rounds : int
        Rounds of matching.
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
    """Measure noise and pixel-phase error, select the stars within 4 standard deviations, and adjust by least squares.

    This is done three times. Lens and pixel-phase error are almost uncorrelated, since one varies over the frame and the
    other within a pixel.
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
    """Return the standard deviations of the positions from detection, shape (n,); 0 where it gave none."""
    sigma = np.zeros(len(pairs))
    for i, frame in enumerate(field.frames):
        rows = pairs.frame == i
        if frame.detections.sigma_px is not None:
            sigma[rows] = frame.detections.sigma_px[pairs.detection[rows]]
    return sigma
