"""The bars of the default solver on random fields, and the command that measures it against them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmark.fields.solver_bars import Measured, measure
from benchmark.fields.solver_effort import calibration_s
from benchmark.fields.solver_fields import HEIGHT, WIDTH, Condition
from benchmark.fields.solver_times import centroid_times_ms, image_times_ms, large_image_times_ms

# Largest share of wrong fixes claimed as ok among all fields of a stress row.
MOST_WRONG = 0.003


@dataclass(frozen=True)
class Bar:
    """One row: conditions, the least share solved in each, and the most that may be wrong over all of them."""

    name: str
    conditions: tuple[Condition, ...]
    least_solved: float
    most_wrong: float = 0.0


def _three(hfov_deg: float, depths: Iterable[float]) -> tuple[Condition, ...]:
    """Conditions at every depth: clean; half a pixel of noise; half a pixel with 20 % missing and 20 % false."""
    return tuple(
        Condition(f"{hfov_deg:.0f} deg V{v:g} {name}", hfov_deg, v, noise, missing, false)
        for v in depths
        for name, noise, missing, false in (
            ("clean", 0.0, 0.0, 0.0),
            ("0.5 px", 0.5, 0.0, 0.0),
            ("20/20", 0.5, 0.2, 0.2),
        )
    )


BARS = (
    Bar("120 deg, V 4-8: clean, 0.5 px, 20 % missing + 20 % false", _three(120, (4, 5, 6, 7, 8)), 0.995),
    Bar("60 deg, V 5-8, same three", _three(60, (5, 6, 7, 8)), 0.99),
    Bar("20 deg, V 6-8, same three", _three(20, (6, 7, 8)), 0.99),
    Bar(
        "exact attitude, V 4-8: 0.5 px, 50 % missing + 200 % false",
        tuple(Condition(f"exact V{v} 50/200", 120, v, 0.5, 0.5, 2.0, exact_attitude=True) for v in (4, 5, 6, 7, 8)),
        0.999,
    ),
    Bar(
        "180 deg equidistant, V 4-6, same three",
        tuple(
            Condition(f"fisheye V{v} {name}", 180, v, noise, missing, false, equidistant=True)
            for v in (4, 5, 6)
            for name, noise, missing, false in (("clean", 0, 0, 0), ("0.5 px", 0.5, 0, 0), ("20/20", 0.5, 0.2, 0.2))
        ),
        0.995,
    ),
    Bar("noise 2 px", (Condition("noise 2 px", noise_px=2.0),), 0.99, MOST_WRONG),
    Bar("noise 4 px", (Condition("noise 4 px", noise_px=4.0),), 0.90, MOST_WRONG),
    Bar("50 % missing + 100 % false", (Condition("50/100", noise_px=0.5, missing=0.5, false=1.0),), 0.98, MOST_WRONG),
    Bar("60 % missing + 200 % false", (Condition("60/200", noise_px=0.5, missing=0.6, false=2.0),), 0.70, MOST_WRONG),
    Bar("15 false brighter than all", (Condition("15 bright", noise_px=0.5, bright_false=15),), 0.99, MOST_WRONG),
    Bar("half the sky clouded", (Condition("cloud", noise_px=0.5, cloud=True),), 0.99, MOST_WRONG),
    Bar(
        "focal length 3 % off",
        (
            Condition("focal +3 %", noise_px=0.5, focal_error=0.03),
            Condition("focal -3 %", noise_px=0.5, focal_error=-0.03),
        ),
        0.99,
        MOST_WRONG,
    ),
)
ACCURACY = Condition("accuracy, exact attitude", noise_px=0.5, exact_attitude=True)
CLEAN = Condition("clean, exact attitude", exact_attitude=True)
CLEAN_30 = Condition("clean, exact attitude, 30 stars", exact_attitude=True, brightest=30)
ACCURACY_RATIO, CLEAN_KM, ELLIPSE = 1.15, 0.020, (0.93, 0.97)
CENTROID_MS, CENTROID_P95_MS, IMAGE_MS, LARGE_IMAGE_MS = 3.0, 15.0, 20.0, 3000.0


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes
    ----------
    condition, bar : str
        What was measured, and the required bar.
    values : mapping of str to float
        The measured numbers by name; names include units.
    shown : tuple of str
        Values as shown in the table: value, wrong fixes, median time.
    reached : bool
    """

    condition: str
    bar: str
    values: Mapping[str, float]
    shown: tuple[str, str, str]
    reached: bool

    def line(self) -> str:
        """Return the row in Markdown."""
        return f"| {self.condition} | {self.bar} | {' | '.join(self.shown)} | {'yes' if self.reached else 'NO'} |"


@dataclass(frozen=True, eq=False)
class Outcome:
    """A bar and its measurements."""

    bar: Bar
    measured: tuple[Measured, ...]

    @property
    def least_solved(self) -> float:
        """Share solved in the worst of its conditions."""
        return min(one.solved for one in self.measured)

    @property
    def wrong(self) -> int:
        """Number of wrong fixes in all of its conditions."""
        return sum(one.wrong for one in self.measured)

    @property
    def passed(self) -> bool:
        """Whether the bar is reached by every condition."""
        fields = sum(len(one.error_km) for one in self.measured)
        return self.least_solved >= self.bar.least_solved and self.wrong <= self.bar.most_wrong * fields

    def row(self) -> Row:
        """Return its row of the table."""
        ms = float(np.median(np.concatenate([one.time_ms for one in self.measured])))
        fields = sum(len(one.error_km) for one in self.measured)
        return Row(
            self.bar.name,
            f">= {self.bar.least_solved:.1%}",
            {"solved": self.least_solved, "wrong": self.wrong, "fields": fields, "median_ms": ms},
            (f"{self.least_solved:.1%}", f"{self.wrong} of {fields}", f"{ms:.1f}"),
            self.passed,
        )


def measure_bar(bar: Bar, n_fields: int, seed: int, solver: str = "skybench") -> Outcome:
    """Measure a row, with `n_fields` fields of each condition."""
    return Outcome(bar, tuple(measure(condition, n_fields, seed, solver) for condition in bar.conditions))


def solver_speed(n_fields: int = 100, seed: int = 2026, echo: Callable[[str], None] = print) -> tuple[Row, ...]:
    """Measure every row and print the table row by row; return the rows.

    Parameters
    ----------
    n_fields : int
        Number of random fields of each condition.
    seed : int
        Seed of the fields.
    echo : callable
        Receives the printed lines.
    """
    echo(f"{n_fields} random fields of each condition, seed {seed}, {WIDTH}x{HEIGHT}\n")
    echo("| condition | bar | solved, worst condition | wrong | median ms | reached |")
    echo("|-|-|-|-|-|-|")
    rows = []
    for bar in BARS:
        rows.append(measure_bar(bar, n_fields, seed).row())
        echo(rows[-1].line())
    accuracy = measure(ACCURACY, n_fields, seed)
    ratio = float(np.nanmedian(accuracy.error_km) / np.median(accuracy.bound_km))
    clean = max(float(np.nanmedian(measure(condition, n_fields, seed).error_km)) for condition in (CLEAN, CLEAN_30))
    centroids = centroid_times_ms(min(n_fields, 100), seed)
    images = image_times_ms(min(n_fields, 10), seed)
    median_ms, p95_ms, image_ms = (
        float(np.median(centroids)),
        float(np.percentile(centroids, 95)),
        float(np.median(images)),
    )
    loop_ms = 1000 * calibration_s()
    large = large_image_times_ms(min(n_fields, 2), seed)
    large_ms = float(np.median(large.time_ms))
    inside = accuracy.inside_ellipse
    accurate = (
        Row(
            "accuracy: median error / Cramer-Rao median",
            f"<= {ACCURACY_RATIO}",
            {"ratio": ratio},
            (f"{ratio:.2f}", "", ""),
            ratio <= ACCURACY_RATIO,
        ),
        Row(
            "truth inside the 95 % ellipse",
            "93-97 %",
            {"inside": inside},
            (f"{inside:.1%}", "", ""),
            ELLIPSE[0] <= inside <= ELLIPSE[1],
        ),
        Row(
            "clean, exact attitude: median error",
            "<= 20 m",
            {"median_km": clean},
            (f"{1000 * clean:.1f} m", "", ""),
            clean <= CLEAN_KM,
        ),
        Row(
            "centroids to fix, median / p95",
            f"<= {CENTROID_MS:g} / {CENTROID_P95_MS:g} ms",
            {"median_ms": median_ms, "p95_ms": p95_ms, "loop_ms": loop_ms},
            (f"{median_ms:.1f} / {p95_ms:.1f} ms ({median_ms / loop_ms:.2f} / {p95_ms / loop_ms:.2f} loops)", "", ""),
            median_ms <= CENTROID_MS and p95_ms <= CENTROID_P95_MS,
        ),
        Row(
            "image to fix, median",
            f"<= {IMAGE_MS:g} ms",
            {"median_ms": image_ms, "loop_ms": loop_ms},
            (f"{image_ms:.1f} ms ({image_ms / loop_ms:.2f} loops)", "", ""),
            image_ms <= IMAGE_MS,
        ),
        Row(
            "image of 61 megapixels to fix, median",
            f"<= {LARGE_IMAGE_MS:g} ms",
            {"median_ms": large_ms, "loop_ms": loop_ms, "detections": large.detections, "error_km": large.error_km},
            (
                f"{large_ms:.0f} ms ({large_ms / loop_ms:.0f} loops); {large.detections:.0f} detections, "
                f"{1000 * large.error_km:.1f} m",
                "",
                "",
            ),
            large_ms <= LARGE_IMAGE_MS,
        ),
    )
    for row in accurate:
        echo(row.line())
    echo(f"\nall times are processor time of one thread; a loop is the calibration loop of this run: {loop_ms:.1f} ms")
    return (*rows, *accurate)
