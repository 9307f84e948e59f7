"""`skybench plan`: what a scenario would produce."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmark.cli.errors import fail
from benchmark.cli.output import AsJson, print_json, print_tables, print_warnings
from benchmark.cli.progress import working
from benchmark.cli.rendering import Scenario
from generator.errors import GeneratorError

if TYPE_CHECKING:
    from generator.dataset.forecast import Forecast
    from generator.scenario.file import Scenario as LoadedScenario


def add_to(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Example: skybench plan thesis_mag")(plan)


def plan(
    scenario: Scenario,
    measure: Annotated[
        bool, typer.Option("--measure", help="Render four frames, not the first alone, to know time and size.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Print what a scenario would produce: frames, values, light, stars, time and size; and likely mistakes."""
    from rich.table import Column, Table

    from benchmark.report.formatting import duration, file_size
    from generator.dataset.forecast import forecast
    from generator.dataset.layout import natural_shard_size
    from generator.scenario.file import load_scenario
    from generator.scenario.shipped import find_scenario

    try:
        loaded = load_scenario(find_scenario(scenario))
        with working("planning"):
            expected = forecast(loaded, measure)
    except GeneratorError as error:
        fail(error)
    sweeps = {".".join(sweep.path): sweep.values for axis in loaded.axes for sweep in axis}
    draws = {".".join(draw.path): _as_written(loaded.template, draw.path) for draw in loaded.draws}
    files = {file.path: file.sha256 for file in loaded.files}
    if as_json:
        identity = {"name": loaded.name, "sha256": loaded.sha256, "seed": loaded.seed}
        identity |= {"sequences": loaded.sequence_count, "frames_per_sequence": loaded.steps}
        varied = {"sweeps": {key: list(values) for key, values in sweeps.items()}, "draws": draws, "files": files}
        print_json(identity | asdict(expected) | varied)
        return
    table = Table("", Column(loaded.name, overflow="fold"), show_header=True)
    table.add_row("frames", _frames(loaded))
    if loaded.sequence_count:
        table.add_row("sequence", _sequence(loaded))
    for name, values in sweeps.items():
        table.add_row(f"sweep {name}", _listing(values))
    for name, distribution in draws.items():
        table.add_row(f"draw {name}", distribution)
    for name in files:
        table.add_row("file", name)
    for row in _first_frame(expected):
        table.add_row(*row)
    known = "from four frames" if expected.measured else "from the first frame; --measure renders four"
    table.add_row("time", f"{duration(expected.seconds)} with `generate` on {expected.cores} cores ({known})")
    table.add_row(
        "size",
        f"{file_size(expected.bytes)} as 16-bit PNG with truth; {file_size(expected.exr_bytes)} more "
        "with the expected electrons (EXR)",
    )
    size = natural_shard_size(loaded.frame_count)
    table.add_row("shards", f"{math.ceil(loaded.frame_count / size)} of up to {size} frames")
    table.add_row("scenario hash", loaded.sha256)
    print_tables(table)
    print_warnings(expected.warnings)


def _frames(scenario: LoadedScenario) -> str:
    steps = "" if scenario.steps is None else f" sequences x {scenario.steps} frames"
    return f"{scenario.frame_count} ({scenario.combination_count} combinations x {scenario.repeats}{steps})"


def _sequence(scenario: LoadedScenario) -> str:
    """Times and inertial unit of the first sequence."""
    spec = scenario.sequence(0)
    end = scenario.frame(spec.time.count - 1).time.utc_start
    inertial = "" if spec.imu is None else f"; inertial unit at {spec.imu.rate_hz:g} Hz"
    return f"every {spec.time.every_s:g} s from {spec.time.utc_start} to {end}{inertial}"


def _first_frame(expected: Forecast) -> list[tuple[str, str]]:
    """Rows of the table about the first frame."""
    from generator.frame.record import VISIBLE_SNR

    first = expected.first
    signal_e = first.sky_e + first.dark_e
    return [
        ("image", f"{expected.width} x {expected.height}, {expected.bits} bits"),
        ("field of view", f"{first.hfov_deg:.4g} x {first.vfov_deg:.4g} deg"),
        (
            "pointing",
            f"azimuth {first.azimuth_deg:.2f}, altitude {first.altitude_deg:.2f}, roll {first.roll_deg:.2f} deg",
        ),
        ("f-number", "unknown without pixel_pitch_um" if first.f_number is None else f"f/{first.f_number:.3g}"),
        (
            "sky and dark",
            f"{first.sky_e:.3g} + {first.dark_e:.3g} e per pixel: {signal_e / first.full_well_e:.2%} of the full well "
            f"({first.full_well_e:g} e), {signal_e / first.range_e:.2%} of the converter's range ({first.range_e:.4g} e)",
        ),
        (
            "stars",
            f"{first.visible_stars} with SNR >= {VISIBLE_SNR:g}, {first.saturated_stars} saturated; "
            f"{expected.catalogue_stars} in the catalogue above the horizon",
        ),
        ("saturated pixels", f"{first.saturated_share:.2%}"),
        ("Sun, Moon", f"altitudes {first.sun_altitude_deg:.1f}, {first.moon_altitude_deg:.1f} deg"),
    ]


def _listing(values: tuple[object, ...]) -> str:
    shown = ", ".join(str(value) for value in values[:12])
    return shown + (f", … ({len(values)})" if len(values) > 12 else "")


def _as_written(tree: Any, path: tuple[str, ...]) -> str:
    """A scenario's value as written in its file, on one line."""
    from generator.reading.strict_yaml import strict_text

    for key in path:
        tree = tree[int(key)] if isinstance(tree, list) else tree[key]
    return strict_text(tree, default_flow_style=True, width=1000).strip()
