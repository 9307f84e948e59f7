"""Inputs without an answer that are most costly for a solver: clutter in many shapes, with and without brightness.

Each input depends only on a seed and its number, so the worst of a thousand can be reproduced.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

import celnav
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition, make_field

F8 = NDArray[np.float64]
UTC = "2024-03-01T22:00:00Z"
_CORNER = np.array([WIDTH - 1.0, HEIGHT - 1.0])
FEWEST, MOST, CROWD = 5, 5_000, 100_000

CAMERAS = MappingProxyType(
    {
        "pinhole 120 deg": celnav.Camera.pinhole(WIDTH, HEIGHT, 120),
        "pinhole 60 deg": celnav.Camera.pinhole(WIDTH, HEIGHT, 60),
        "pinhole 20 deg": celnav.Camera.pinhole(WIDTH, HEIGHT, 20),
        "equidistant 180 deg": celnav.Camera("equidistant", WIDTH, HEIGHT, f_px=WIDTH / math.pi),
    }
)
ATTITUDES: MappingProxyType[str, celnav.Attitude | None] = MappingProxyType(
    {
        "none": None,
        "vertical": celnav.Attitude.up([0.0, 0.0, 1.0]),
        "exact": celnav.Attitude.zenith_north_up(),
    }
)


@dataclass(frozen=True, eq=False)
class HostileInput:
    """A question to `celnav.solve` that has no answer.

    Attributes
    ----------
    kind, camera_name, attitude_name : str
        Keys of `KINDS`, `CAMERAS` and `ATTITUDES`.
    number : int
        Number of the input.
    uv : ndarray, shape (n, 2)
        Detections.
    flux : ndarray, shape (n,), or None
        Their brightness.
    """

    kind: str
    camera_name: str
    attitude_name: str
    number: int
    uv: F8
    flux: F8 | None

    @property
    def name(self) -> str:
        """Describe the input in words."""
        brightness = "without flux" if self.flux is None else "with flux"
        return (
            f"number {self.number}: {len(self.uv)} detections, {self.kind}, {brightness}, {self.camera_name}, "
            f"attitude {self.attitude_name}"
        )

    def solve(self, solver: str | celnav.SkybenchSolver = "skybench") -> celnav.Fix:
        """Put the question to a solver."""
        camera, attitude = CAMERAS[self.camera_name], ATTITUDES[self.attitude_name]
        return celnav.solve(self.uv, camera, UTC, attitude, solver, flux=self.flux)


def _uniform(rng: np.random.Generator, n: int) -> F8:
    return np.asarray(rng.random((n, 2)) * _CORNER)


def _clusters(rng: np.random.Generator, n: int) -> F8:
    middles = _uniform(rng, max(2, n // 40))
    around = middles[rng.integers(len(middles), size=n)] + rng.normal(0, rng.uniform(2, 40), (n, 2))
    return np.asarray(np.clip(around, 0, _CORNER))


def _lattice(rng: np.random.Generator, n: int) -> F8:
    step = math.sqrt(WIDTH * HEIGHT / n)
    axes = np.meshgrid(np.arange(0, WIDTH - 1, step), np.arange(0, HEIGHT - 1, step))
    return np.asarray(rng.permutation(np.column_stack([axis.ravel() for axis in axes]))[:n])


def _lines(rng: np.random.Generator, n: int) -> F8:
    ends = _uniform(rng, 2 * max(1, n // 60)).reshape(-1, 2, 2)
    chosen, along = ends[rng.integers(len(ends), size=n)], rng.random((n, 1))
    return np.asarray(chosen[:, 0] * (1 - along) + chosen[:, 1] * along)


def _duplicates(rng: np.random.Generator, n: int) -> F8:
    places = _uniform(rng, max(3, n // 10))
    return np.asarray(np.clip(places[rng.integers(len(places), size=n)] + rng.normal(0, 0.1, (n, 2)), 0, _CORNER))


def _mirrored_stars(rng: np.random.Generator, n: int) -> F8:
    """Mirrored true stars: every separation is correct, but no orientation fits."""
    field = make_field(Condition("mirrored", v_max=6.0), int(rng.integers(2**31)), 0)
    return np.asarray((field.uv * [-1, 1] + [WIDTH - 1, 0])[:n])


def _crowd(rng: np.random.Generator, n: int) -> F8:
    """Far more detections than any frame shows."""
    return _uniform(rng, int(CROWD * (n / MOST)))


KINDS: MappingProxyType[str, Callable[[np.random.Generator, int], F8]] = MappingProxyType(
    {
        "uniform": _uniform,
        "clusters": _clusters,
        "lattice": _lattice,
        "lines": _lines,
        "duplicates": _duplicates,
        "mirrored stars": _mirrored_stars,
        "crowd": _crowd,
    }
)


def make_hostile(seed: int, number: int) -> HostileInput:
    """Make one input: kinds in turn; camera, attitude, number of detections (log-uniform) and brightness at random."""
    rng = np.random.default_rng([seed, number])
    kind = list(KINDS)[number % len(KINDS)]
    n = round(math.exp(rng.uniform(math.log(FEWEST), math.log(MOST))))
    camera_name = list(CAMERAS)[rng.integers(len(CAMERAS))]
    attitude_name = list(ATTITUDES)[rng.integers(len(ATTITUDES))]
    with_flux = bool(rng.integers(2))
    uv = KINDS[kind](rng, n)
    return HostileInput(kind, camera_name, attitude_name, number, uv, rng.random(len(uv)) if with_flux else None)
