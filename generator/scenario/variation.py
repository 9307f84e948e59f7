"""Values that vary over the frames of a scenario: sweeps and distributions.

Any value of a scenario, even inside a list, may be replaced by a mapping with one of these keys:

=========================================  ==========================================================================
mapping                                    meaning
=========================================  ==========================================================================
``{sweep: [a, b, c]}``                     each in turn; sweeps multiply, the last written varies fastest
``{sweep: [a, b, c], zip: name}``          sweeps of one name advance together
``{uniform: [low, high]}``                 a number, uniform
``{integer: [low, high]}``                 an integer, uniform, both ends included
``{normal: [mean, sigma]}``                a number, Gaussian; ``limits: [low, high]`` truncates it
``{choice: [a, b, c]}``                    one of them, equally likely
``{sphere_latitude: [south, north]}``      a latitude in deg, uniform over the area of the sphere
``{utc: [start, end]}``                    a time, uniform; ``sun_below_deg: -6`` keeps the Sun's centre below that
=========================================  ==========================================================================

For each frame, each distribution draws from a random stream of its own, named after its key path, so adding one does
not change any other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from scipy.special import ndtr, ndtri

from generator.errors import ScenarioError
from generator.places.sun import sun_altitude_deg
from generator.places.times import Instant

KeyPath = tuple[str, ...]
DEEPEST_NESTING = 20
"""Limit of the nesting; scenarios need five levels."""
LARGEST_NUMBER_OF_TRIES = 10_000
"""Number of draws of a time after which a condition on the Sun counts as impossible."""
SWEEP_KEY = "sweep"
MOST_SWEPT_VALUES = 10_000
"""Each value is checked when the scenario is read; larger numbers are better drawn from a distribution."""
LARGEST_INTEGER = 2**63 - 1
"""Largest integer that a random generator draws."""
LARGEST_NUMBER, LEAST_SIGMA = 1e100, 1e-100
"""Limits of a distribution's numbers: differences and quotients of two are finite."""


@dataclass(frozen=True)
class Sweep:
    """Values that one key takes in turn; sweeps with the same `zip_name` advance together."""

    path: KeyPath
    values: tuple[Any, ...]
    zip_name: str | None


@dataclass(frozen=True)
class Observer:
    """Where a frame's camera stands, for distributions that depend on it (deg)."""

    latitude_deg: float
    longitude_deg: float


class Distribution(Protocol):
    """A random value of one key."""

    needs_site: ClassVar[bool]

    def typical(self) -> list[Any]:
        """Values at the ends of the range, to be checked before any frame is made."""

    def draw(self, rng: np.random.Generator, observer: Observer | None) -> Any:
        """One value."""


@dataclass(frozen=True)
class Uniform:
    """A number, uniform between two limits."""

    low: float
    high: float
    needs_site: ClassVar[bool] = False

    def typical(self) -> list[Any]:
        """Both limits."""
        return [float(self.low), float(self.high)]

    def draw(self, rng: np.random.Generator, observer: Observer | None) -> float:
        """One number."""
        return float(rng.uniform(self.low, self.high))


@dataclass(frozen=True)
class UniformInteger:
    """An integer, uniform, both limits included."""

    low: int
    high: int
    needs_site: ClassVar[bool] = False

    def typical(self) -> list[Any]:
        """Both limits."""
        return [int(self.low), int(self.high)]

    def draw(self, rng: np.random.Generator, observer: Observer | None) -> int:
        """One integer."""
        return int(rng.integers(self.low, self.high, endpoint=True))


FARTHEST_LIMIT_SIGMA = 6.0
"""Beyond this limit, less than 1e-9 of a Gaussian is left, and inversion reaches the limits of double precision."""


@dataclass(frozen=True)
class Normal:
    """A Gaussian number, truncated to limits (by inversion, so that one draw is one random number)."""

    mean: float
    sigma: float
    low: float
    high: float
    needs_site: ClassVar[bool] = False

    def typical(self) -> list[Any]:
        """Mean and finite limits."""
        return [float(value) for value in (self.mean, self.low, self.high) if np.isfinite(value)]

    def draw(self, rng: np.random.Generator, observer: Observer | None) -> float:
        """One number."""
        low, high = ndtr((np.array([self.low, self.high], dtype=np.float64) - self.mean) / self.sigma)
        return float(np.clip(self.mean + self.sigma * ndtri(rng.uniform(low, high)), self.low, self.high))


@dataclass(frozen=True)
class Choice:
    """One of several values, equally likely."""

    values: tuple[Any, ...]
    needs_site: ClassVar[bool] = False

    def typical(self) -> list[Any]:
        """All of them."""
        return list(self.values)

    def draw(self, rng: np.random.Generator, observer: Observer | None) -> Any:
        """One value."""
        return self.values[int(rng.integers(len(self.values)))]


@dataclass(frozen=True)
class SphereLatitude:
    """A latitude, uniform over the sphere's area between two parallels: its sine is uniform."""

    south_deg: float
    north_deg: float
    needs_site: ClassVar[bool] = False

    def typical(self) -> list[Any]:
        """Both parallels."""
        return [float(self.south_deg), float(self.north_deg)]

    def draw(self, rng: np.random.Generator, observer: Observer | None) -> float:
        """One latitude, deg."""
        south, north = np.sin(np.radians([self.south_deg, self.north_deg]))
        return float(np.degrees(np.arcsin(rng.uniform(south, north))))


@dataclass(frozen=True)
class UtcRange:
    """A UTC instant, uniform between two, to the millisecond; with the Sun below an altitude if asked."""

    start: str
    end: str
    sun_below_deg: float | None
    needs_site: ClassVar[bool] = True

    def typical(self) -> list[Any]:
        """Both ends."""
        return [self.start, self.end]

    def draw(self, rng: np.random.Generator, observer: Observer | None) -> str:
        """One instant, ISO 8601.

        Raises
        ------
        ScenarioError
            The Sun does not go below the altitude within LARGEST_NUMBER_OF_TRIES draws.
        """
        start, end = Instant.parse(self.start), Instant.parse(self.end)
        length_s = (end.mjd - start.mjd) * 86400
        for _ in range(LARGEST_NUMBER_OF_TRIES):
            instant = start.plus(float(np.round(rng.uniform(0, length_s), 3)))
            if self.sun_below_deg is None:
                return instant.isoformat()
            if observer is None:
                raise ScenarioError("sun_below_deg needs a site with latitude_deg and longitude_deg")
            if sun_altitude_deg(instant, observer.latitude_deg, observer.longitude_deg) < self.sun_below_deg:
                return instant.isoformat()
        where = f"latitude {observer.latitude_deg:.1f} deg" if observer else "the site"
        raise ScenarioError(
            f"the Sun is not below {self.sun_below_deg} deg at {where} between {self.start} and {self.end}"
        )


@dataclass(frozen=True)
class Draw:
    """A distribution and the key whose values it draws."""

    path: KeyPath
    distribution: Distribution

    @property
    def stream(self) -> str:
        """Name of its random stream."""
        return "scenario:" + ".".join(self.path)

    def meaning(self) -> dict[str, Any]:
        """The distribution's kind and parameters as JSON-ready data, for the scenario's hash."""
        parameters = {name: str(value) for name, value in sorted(vars(self.distribution).items())}
        return {"kind": type(self.distribution).__name__, **parameters}


def find_variations(tree: Any, source: str) -> tuple[list[Sweep], list[Draw]]:
    """Find the sweeps and distributions of a scenario tree, in the order in which they are written.

    Raises
    ------
    ScenarioError
        One of them is malformed.
    """
    sweeps, draws = [], []
    for path, node in _variation_nodes(tree, (), source):
        where = f"{source}: {'.'.join(path) or '(top)'}"
        if SWEEP_KEY in node:
            sweeps.append(_sweep(path, node, where))
        else:
            draws.append(Draw(path, _distribution(node, where)))
    return sweeps, draws


def _variation_nodes(tree: Any, path: KeyPath, source: str) -> Iterator[tuple[KeyPath, dict[str, Any]]]:
    if len(path) > DEEPEST_NESTING:
        raise ScenarioError(f"{source}: {'.'.join(path[:3])}…: nested deeper than {DEEPEST_NESTING} levels")
    if isinstance(tree, list):
        for place, value in enumerate(tree):
            yield from _variation_nodes(value, (*path, str(place)), source)
        return
    if not isinstance(tree, dict):
        return
    if SWEEP_KEY in tree or any(key in tree for key in _DISTRIBUTIONS):
        yield path, tree
        return
    for key, value in tree.items():
        yield from _variation_nodes(value, (*path, str(key)), source)


def _sweep(path: KeyPath, node: dict[str, Any], where: str) -> Sweep:
    _only_keys(node, (SWEEP_KEY, "zip"), where)
    values, zip_name = node[SWEEP_KEY], node.get("zip")
    if not isinstance(values, list) or not values:
        raise ScenarioError(f"{where}.{SWEEP_KEY}: found {describe(values)}, expected a list of at least one value")
    if len(values) > MOST_SWEPT_VALUES:
        raise ScenarioError(f"{where}.{SWEEP_KEY}: found {len(values)} values, at most {MOST_SWEPT_VALUES} are swept")
    if zip_name is not None and not isinstance(zip_name, str):
        raise ScenarioError(f"{where}.zip: found {describe(zip_name)}, expected a name")
    return Sweep(path, tuple(values), zip_name)


def _distribution(node: dict[str, Any], where: str) -> Distribution:
    key = next(key for key in _DISTRIBUTIONS if key in node)
    build, extra_keys = _DISTRIBUTIONS[key]
    _only_keys(node, (key, *extra_keys), where)
    result: Distribution = build(node, f"{where}.{key}")
    return result


def _only_keys(node: dict[str, Any], allowed: tuple[str, ...], where: str) -> None:
    unknown = sorted(str(key) for key in node if key not in allowed)
    if unknown:
        raise ScenarioError(
            f"{where}.{unknown[0]}: unknown key; expected '{allowed[0]}'"
            + (f" with or without '{allowed[1]}'" if len(allowed) > 1 else " alone")
        )


def _pair(
    value: Any, where: str, kind: type | tuple[type, ...], what: str, *, endless: bool = False
) -> tuple[Any, Any]:
    proper = isinstance(value, list) and len(value) == 2
    if not proper or any(not isinstance(item, kind) or isinstance(item, bool) for item in value):
        raise ScenarioError(f"{where}: found {describe(value)}, expected [{what}]")
    for item in value:
        if not (endless and isinstance(item, float) and np.isinf(item)):
            _check_number(item, where)
    return value[0], value[1]


def _check_number(item: Any, where: str) -> None:
    if isinstance(item, int) and abs(item) > LARGEST_INTEGER:
        raise ScenarioError(f"{where}: found {describe(item)}, expected an integer within 2^63 - 1")
    if isinstance(item, float) and not abs(item) <= LARGEST_NUMBER:
        raise ScenarioError(f"{where}: found {describe(item)}, expected a finite number within {LARGEST_NUMBER:g}")


def _ordered(
    value: Any, where: str, kind: type | tuple[type, ...] = (int, float), *, endless: bool = False
) -> tuple[Any, Any]:
    """Read two limits; `endless` also accepts infinite ones, which leave a side open."""
    low, high = _pair(value, where, kind, "low, high", endless=endless)
    if not low < high:
        raise ScenarioError(f"{where}: found [{low}, {high}], expected the lower limit first")
    return low, high


def _normal(node: dict[str, Any], where: str) -> Normal:
    mean, sigma = _pair(node["normal"], where, (int, float), "mean, sigma")
    if not sigma >= LEAST_SIGMA:
        raise ScenarioError(f"{where}: found sigma {sigma}, expected a positive one, at least {LEAST_SIGMA:g}")
    beside = f"{where.removesuffix('.normal')}.limits"
    limits = _ordered(node["limits"], beside, endless=True) if "limits" in node else (-np.inf, np.inf)
    if limits[0] > mean + FARTHEST_LIMIT_SIGMA * sigma or limits[1] < mean - FARTHEST_LIMIT_SIGMA * sigma:
        raise ScenarioError(
            f"{beside}: found {list(limits)}, expected limits with a part of the Gaussian, {mean} +- {sigma}, between "
            f"them; they are more than {FARTHEST_LIMIT_SIGMA:g} sigma to one side"
        )
    return Normal(mean, sigma, *limits)


def _choice(node: dict[str, Any], where: str) -> Choice:
    values = node["choice"]
    if not isinstance(values, list) or not values:
        raise ScenarioError(f"{where}: found {describe(values)}, expected a list of at least one value")
    return Choice(tuple(values))


def _utc(node: dict[str, Any], where: str) -> UtcRange:
    start, end = _pair(node["utc"], where, str, "start, end as UTC times ending in Z")
    try:
        if not Instant.parse(start).mjd < Instant.parse(end).mjd:
            raise ScenarioError(f"{where}: found [{start}, {end}], expected the earlier time first")
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from error
    sun = node.get("sun_below_deg")
    if sun is not None and (isinstance(sun, bool) or not isinstance(sun, int | float) or not -90 < sun <= 90):
        raise ScenarioError(f"{where}.sun_below_deg: found {describe(sun)}, expected degrees from -90 to 90")
    return UtcRange(start, end, sun)


_DISTRIBUTIONS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "uniform": (lambda node, where: Uniform(*_ordered(node["uniform"], where)), ()),
    "integer": (lambda node, where: UniformInteger(*_ordered(node["integer"], where, int)), ()),
    "normal": (_normal, ("limits",)),
    "choice": (_choice, ()),
    "sphere_latitude": (lambda node, where: SphereLatitude(*_ordered(node["sphere_latitude"], where)), ()),
    "utc": (_utc, ("sun_below_deg",)),
}
DISTRIBUTION_KEYS = tuple(_DISTRIBUTIONS)


def describe(value: Any) -> str:
    """Describe a value for messages: its type and a short representation."""
    if isinstance(value, int) and abs(value) > 10**50:
        return "int of more than 50 digits"
    try:
        text = "nothing" if value is None else f"{type(value).__name__} {value!r}"
    except ValueError:  # of an integer within it of more digits than Python prints
        text = f"{type(value).__name__} with a number of more than 50 digits"
    return text if len(text) <= 60 else text[:57] + "..."
