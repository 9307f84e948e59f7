"""Detected stars: their positions, brightness and standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.checking import real_array
from celnav.errors import DetectionError

F8 = NDArray[np.float64]

# A star that is found again, with a star shape measured again, is at most so far from its first position, pixels.
_SAME_STAR_PX = 4.0


@dataclass(frozen=True, eq=False)
class Detections:
    """Detected stars, brightest first.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        Centroids, pixels.
    flux : ndarray, shape (n,), or None
        Light above the background, in the image's unit up to a constant factor; None if unknown.
    shape : tuple of int or None
        Height and width of the image that the detections come from.
    sigma_px : ndarray, shape (n,), or None
        Standard deviation of each centroid along each axis, pixels; None if unknown. For a streak, the root mean square
        of the standard deviations along and across it.
    streak_px : ndarray, shape (n, 2), or None
        Vector from one end of a star's streak to the other, in either sense, pixels; 0 for a star without a streak, None
        if no star has one. The position of a streak is the midpoint of its ends.
    sigma_across_px : ndarray, shape (n,), or None
        Standard deviation across the streak, pixels; equal to `sigma_px` for a star without one. The position along a
        streak is much less certain.
    n_faint : int
        So many detections at the end are fainter than the threshold, most of them noise (`DetectionConfig.faint_stars`).
        `celnav.solve` uses them only where it refuses the others.
    """

    uv: F8
    flux: F8 | None
    shape: tuple[int, int] | None = None
    sigma_px: F8 | None = None
    streak_px: F8 | None = None
    sigma_across_px: F8 | None = None
    n_faint: int = 0

    def __len__(self) -> int:
        return len(self.uv)

    def without_faint(self) -> Detections:
        """Return those above the threshold, which come first."""
        return self._select(np.arange(len(self) - self.n_faint)) if self.n_faint else self

    def followed_by(self, fainter: Detections, n: int) -> Detections:
        """Append the brightest of `fainter` that are not among these stars, up to `n` detections in all."""
        new = np.arange(len(fainter))
        if len(self):
            from scipy.spatial import cKDTree

            new = new[cKDTree(self.uv).query(fainter.uv)[0] > _SAME_STAR_PX]
        added = fainter._select(new[: max(0, n - len(self))])
        flux, sigma = (_joined(x, y) for x, y in ((self.flux, added.flux), (self.sigma_px, added.sigma_px)))
        streak = across = None
        if self.streak_px is not None or added.streak_px is not None:
            both = self, added
            streak = np.concatenate([np.zeros((len(x), 2)) if x.streak_px is None else x.streak_px for x in both])
            across = _joined(*(x.sigma_px if x.sigma_across_px is None else x.sigma_across_px for x in both))
        uv = np.concatenate((self.uv, added.uv))
        return Detections(uv, flux, self.shape, sigma, streak, across, len(added))

    def _select(self, rows: NDArray[np.intp]) -> Detections:
        columns = self.flux, self.sigma_px, self.streak_px, self.sigma_across_px
        flux, sigma, streak, across = (None if column is None else column[rows] for column in columns)
        return Detections(self.uv[rows], flux, self.shape, sigma, streak, across)


def _joined(first: F8 | None, second: F8 | None) -> F8 | None:
    return None if first is None or second is None else np.concatenate((first, second))


def as_positions(uv: ArrayLike) -> F8:
    """Return pixel positions as an (n, 2) array of finite numbers; raise `DetectionError` if they are not valid."""
    positions = _unmasked("detections", uv)
    if positions.size == 0:
        return np.empty((0, 2))
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise DetectionError(f"detections have shape {positions.shape}; they must be (n, 2): u and v in pixels")
    if not (finite := np.isfinite(positions).all(axis=1)).all():
        raise DetectionError(
            f"detection {int(np.flatnonzero(~finite)[0])} has a NaN or infinite position: leave out such detections"
        )
    return positions


def as_detections(detections: Detections | ArrayLike, flux: ArrayLike | None = None) -> Detections:
    """Return validated detections for any value that `celnav.solve` accepts as detections."""
    shape, sigma, streak, across, n_faint = None, None, None, None, 0
    if isinstance(detections, Detections):
        if flux is not None:
            raise DetectionError("give flux either in the detections or as flux=, not both")
        positions, flux, shape = as_positions(detections.uv), detections.flux, detections.shape
        n_faint = detections.n_faint
        if not 0 <= n_faint <= len(positions):
            raise DetectionError(f"n_faint = {n_faint} must be between 0 and the {len(positions)} detections")
        if detections.sigma_px is not None:
            sigma = _column("sigma_px", detections.sigma_px, len(positions))
            if (sigma <= 0).any():
                raise DetectionError("sigma_px must be positive")
        if detections.sigma_across_px is not None:
            across = _column("sigma_across_px", detections.sigma_across_px, len(positions))
            if sigma is None or (across <= 0).any():
                raise DetectionError("sigma_across_px must be positive, and stand beside sigma_px")
        if detections.streak_px is not None:
            streak = real_array(detections.streak_px, "streak_px", DetectionError)
            if streak.shape != (len(positions), 2):
                raise DetectionError(f"streak_px has shape {streak.shape}; it must be ({len(positions)}, 2)")
            if not np.isfinite(streak).all():
                raise DetectionError("streak_px holds NaN or infinity")
    else:
        positions = as_positions(detections)
    brightness = None if flux is None else _column("flux", flux, len(positions))
    return Detections(positions, brightness, shape, sigma, streak, across, n_faint)


def _unmasked(name: str, values: ArrayLike) -> F8:
    """Return numbers as a new array of floats; raise `DetectionError` if some entries are masked."""
    if np.ma.is_masked(values):
        raise DetectionError(f"{name} has masked entries, which have no value: leave them out")
    return real_array(values, name, DetectionError)


def _column(name: str, values: ArrayLike, n: int) -> F8:
    column = _unmasked(name, values)
    if column.shape != (n,):
        raise DetectionError(f"{name} has shape {column.shape}; it must be ({n},), one per detection")
    if not np.isfinite(column).all():
        raise DetectionError(f"{name} holds NaN or infinity")
    return column
